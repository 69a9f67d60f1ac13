"""Motion vectors from geometry: traditional vectors, dual vectors, and the disocclusion mask.

Dual vectors: Zeng et al. 2021, «Temporally Reliable Motion Vectors», section on occlusions; Eq. 2 of «Neural Temporal
Denoising for Indirect Illumination».
"""

from typing import NamedTuple

import torch
from torch import Tensor

from nte.frames.frame import Frame
from nte.frames.usable import within
from nte.motion.warp import fetch_nearest, inside, nearest_index, pixel_centres, refuse_other_shape

DISOCCLUSION_PX = 0.5  # a dual vector that differs by more than this from the traditional one marks a disocclusion
BEHIND = 1.1  # an occluder's depth is at most this multiple of what it hides; leaves room for motion in depth


class Reprojection(NamedTuple):
    """Where to fetch history, whether that place exists, and whether the surface was hidden there."""

    motion: Tensor  # (N, 2, H, W) pixels, current → previous, always finite
    valid: Tensor  # (N, 1, H, W) bool: the position lies in the previous frame
    disoccluded: Tensor  # (N, 1, H, W) bool: the surface was hidden in the previous frame


def traditional_motion(motion: Tensor) -> Reprojection:
    """Use the given vectors (N, 2, H, W), px, current → previous; those that are not finite become 0 and invalid.

    >>> motion = torch.tensor([[-1.0, 0.0], [float("nan"), 0.0]]).T.view(1, 2, 1, 2)
    >>> vectors = nte.traditional_motion(motion)
    >>> vectors.motion[0, 0].tolist(), vectors.valid[0, 0].tolist()
    ([[-1.0, 0.0]], [[False, False]])
    """
    finite = within(motion)
    motion = torch.where(finite, motion, 0.0)
    valid = finite & inside(pixel_centres(motion) + motion)
    return Reprojection(motion, valid, torch.zeros_like(valid))


def dual_motion(
    motion: Tensor,
    previous_forward_motion: Tensor,
    depth: Tensor | None = None,
    previous_depth: Tensor | None = None,
) -> Reprojection:
    """Compute dual vectors: where a surface was hidden, history comes from beside the occluder and moves along with it.

    motion (N, 2, H, W): px, current → previous. previous_forward_motion (N, 2, H, W): px, on the pixels of the previous
    frame, pointing to the current one; NaN where unknown. depth and previous_depth (N, 1, H, W), 0 = miss: they sharpen
    the mask at silhouettes, where a position between two pixels of the previous frame may round to the background,
    which hid nothing. Raises NteError for images of different sizes.

    With y = x + motion(x), the occluder at y moves to z = y + f(y), and the dual vector's position is
    x^O = y + (x − z) = x − f(y). Nothing was hidden where x^O is y. Where x^O lies outside the image the traditional
    vector stays, as in the paper, but `disoccluded` is still true.

    The background rests, and an object that moves by two pixels has just left the second pixel:

    >>> forward = torch.tensor([[0.0, 2.0, 0.0, 0.0], [0.0] * 4]).view(1, 2, 1, 4)
    >>> vectors = nte.dual_motion(torch.zeros(1, 2, 1, 4), forward)
    >>> vectors.disoccluded[0, 0].tolist()
    [[False, True, False, False]]
    >>> vectors.motion[0, 0, 0, 1].item()  # outside the image, -2, there is nothing to fetch
    0.0
    """
    given = {"previous_forward_motion": previous_forward_motion, "depth": depth, "previous_depth": previous_depth}
    for name, image in given.items():
        refuse_other_shape(name, image, "motion", motion)
    traditional = traditional_motion(motion)
    previous = pixel_centres(motion) + traditional.motion
    # Nearest, not bilinear: a motion interpolated across an edge belongs to no surface.
    forward = fetch_nearest(previous_forward_motion, previous)
    known = traditional.valid & within(forward)
    dual = -torch.where(known, forward, 0.0)
    if depth is not None and previous_depth is not None:
        occluder = infinite_sky(fetch_nearest(previous_depth, previous))
        known = known & ~(occluder > BEHIND * infinite_sky(depth))
    apart = (dual - traditional.motion).square().sum(1, keepdim=True) > DISOCCLUSION_PX**2
    disoccluded = known & apart
    usable = disoccluded & inside(pixel_centres(motion) + dual)
    return Reprojection(torch.where(usable, dual, traditional.motion), traditional.valid, disoccluded)


def frame_vectors(frame: Frame, previous_depth: Tensor | None = None) -> Reprojection:
    """Compute the best vectors that a PyTorch frame allows.

    They are dual vectors if the frame has previous_forward_motion, or motion and depth from which to scatter it: where
    it is missing, or NaN everywhere. Without both they are the traditional ones. previous_depth (N, 1, H, W): depth of
    the previous frame, if known, for a sharper disocclusion mask.

    >>> frame = nte.Clip("data/clips/disc_000").frame(1).torch()
    >>> vectors = nte.frame_vectors(frame)
    >>> bool(vectors.disoccluded.any())  # behind the disc, which moves
    True
    """
    forward, depth = frame.get("previous_forward_motion"), frame.get("depth")
    if depth is not None:
        forward = complete_forward_motion(forward, frame["motion"], depth)
    if forward is None:
        return traditional_motion(frame["motion"])
    return dual_motion(frame["motion"], forward, depth, previous_depth)


def infinite_sky(depth: Tensor) -> Tensor:
    """Return depth (N, 1, H, W) with misses, stored as 0, set to infinity: the form in which depths are compared."""
    return torch.where(depth > 0, depth, float("inf"))


def complete_forward_motion(forward_motion: Tensor | None, motion: Tensor, depth: Tensor) -> Tensor:
    """Return previous_forward_motion (N, 2, H, W), px, scattered in each sequence of the batch that does not know it.

    forward_motion (N, 2, H, W): px, on the previous frame, to the current one. A sequence knows nothing of it where all
    of it is NaN; None stands for that in the whole batch. motion (N, 2, H, W) and depth (N, 1, H, W): as
    `scatter_forward_motion` takes them.
    """
    if forward_motion is None:
        return scatter_forward_motion(motion, depth)
    unknown = forward_motion.isnan().flatten(1).all(1)
    # A GPU would have to finish all work before it could answer this, so there the scattering always runs.
    if forward_motion.device.type == "cpu" and not unknown.any():
        return forward_motion
    return torch.where(unknown.view(-1, 1, 1, 1), scatter_forward_motion(motion, depth), forward_motion)


def scatter_forward_motion(motion: Tensor, depth: Tensor) -> Tensor:
    """Make previous_forward_motion (N, 2, H, W), px, from the current frame: −motion, scattered to x + motion.

    motion (N, 2, H, W): px, current → previous. depth (N, 1, H, W): 0 = miss, which counts as infinitely far. Where
    several surfaces arrive at a pixel of the previous frame, the nearest wins; pixels that none reaches are NaN, which
    `dual_motion` treats as «not disoccluded».

    >>> motion = torch.tensor([[-1.0, -1.0, 0.0], [0.0] * 3]).view(1, 2, 1, 3)
    >>> nte.scatter_forward_motion(motion, torch.tensor([2.0, 2.0, 5.0]).view(1, 1, 1, 3))[0, 0].tolist()
    [[1.0, nan, -0.0]]
    """
    source = traditional_motion(motion)
    target = nearest_index(pixel_centres(motion) + source.motion)
    count = target.shape[-1]
    far = torch.where(source.valid, infinite_sky(depth), float("inf")).flatten(2)
    nearest = torch.full_like(far, float("inf")).scatter_reduce(2, target, far, "amin")
    # Among equally near pixels the last one wins, which is deterministic on every device.
    order = torch.arange(count, device=motion.device).expand_as(target)
    wins = source.valid.flatten(2) & (far == nearest.gather(2, target))
    winner = torch.full_like(target, -1).scatter_reduce(2, target, torch.where(wins, order, -1), "amax")
    forward = -source.motion.flatten(2).gather(2, winner.clamp(min=0).expand(-1, 2, -1))
    return torch.where(winner >= 0, forward, float("nan")).view_as(motion)
