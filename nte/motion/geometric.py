"""Motion vectors from geometry: traditional and dual vectors, and the disocclusion mask.

Dual vectors: Zeng et al. 2021, «Temporally Reliable Motion Vectors», section on occlusions; Eq. 2 of
«Neural Temporal Denoising for Indirect Illumination».
"""

from typing import NamedTuple

import torch
from torch import Tensor

from nte.frames.frame import Frame
from nte.motion.warp import fetch_nearest, inside, nearest_index, pixel_centres

DISOCCLUSION_PX = 0.5  # a dual vector that differs by more than this from the traditional one
BEHIND = 1.1  # an occluder is not this much farther away than what it hides; leaves room for motion in depth


class Reprojection(NamedTuple):
    """Where to fetch history, whether it is there, and whether something hid the surface: three outputs."""

    motion: Tensor  # (N, 2, H, W) pixels, current → previous, always finite
    valid: Tensor  # (N, 1, H, W) bool: the position lies in the previous frame
    disoccluded: Tensor  # (N, 1, H, W) bool: the surface was hidden in the previous frame


def traditional_motion(motion: Tensor) -> Reprojection:
    """Take the given vectors (N, 2, H, W), px, current → previous; one that is not finite becomes 0 and invalid.

    >>> motion = torch.tensor([[-1.0, 0.0], [float("nan"), 0.0]]).T.view(1, 2, 1, 2)
    >>> vectors = nte.traditional_motion(motion)
    >>> vectors.motion[0, 0].tolist(), vectors.valid[0, 0].tolist()
    ([[-1.0, 0.0]], [[False, False]])
    """
    finite = (motion.abs() < float("inf")).all(1, keepdim=True)
    motion = torch.where(finite, motion, 0.0)
    valid = finite & inside(pixel_centres(motion) + motion)
    return Reprojection(motion, valid, torch.zeros_like(valid))


def dual_motion(
    motion: Tensor,
    previous_forward_motion: Tensor,
    depth: Tensor | None = None,
    previous_depth: Tensor | None = None,
) -> Reprojection:
    """Dual vectors: where the surface was hidden, history from beside the occluder, moved along with it.

    motion (N, 2, H, W): current → previous. previous_forward_motion (N, 2, H, W): on the pixels of the
    previous frame, pointing to the current one; NaN where unknown. depth and previous_depth (N, 1, H, W),
    0 = miss, sharpen the mask at silhouettes: the edge of a moving object falls between two pixels of the
    previous frame, and the one it is rounded to may show the background, which hid nothing.

    With y = x + motion(x), the occluder at y is followed to z = y + f(y), and x − z is repeated from y:
    x^O = y + (x − z) = x − f(y). Nothing was hidden where x^O is y. Where x^O leaves the image the
    traditional vector stays, as in the paper, but `disoccluded` still says so.

    The background rests, and an object that moves by two pixels has just left the second pixel:

    >>> forward = torch.tensor([[0.0, 2.0, 0.0, 0.0], [0.0] * 4]).view(1, 2, 1, 4)
    >>> vectors = nte.dual_motion(torch.zeros(1, 2, 1, 4), forward)
    >>> vectors.disoccluded[0, 0].tolist()
    [[False, True, False, False]]
    >>> vectors.motion[0, 0, 0, 1].item()  # outside the image, -2, there is nothing to fetch
    0.0
    """
    traditional = traditional_motion(motion)
    previous = pixel_centres(motion) + traditional.motion
    # Nearest, not bilinear: a motion interpolated across an edge belongs to nobody.
    forward = fetch_nearest(previous_forward_motion, previous)
    known = traditional.valid & (forward.abs() < float("inf")).all(1, keepdim=True)
    dual = -torch.where(known, forward, 0.0)
    if depth is not None and previous_depth is not None:
        occluder = infinite_sky(fetch_nearest(previous_depth, previous))
        known = known & ~(occluder > BEHIND * infinite_sky(depth))
    apart = (dual - traditional.motion).square().sum(1, keepdim=True) > DISOCCLUSION_PX**2
    disoccluded = known & apart
    usable = disoccluded & inside(pixel_centres(motion) + dual)
    return Reprojection(torch.where(usable, dual, traditional.motion), traditional.valid, disoccluded)


def frame_vectors(frame: Frame, previous_depth: Tensor | None = None) -> Reprojection:
    """Make the vectors of a PyTorch frame from whatever it has: dual ones through its previous_forward_motion, or
    through one scattered from motion and depth; without depth either, the traditional ones.

    previous_depth (N, 1, H, W): that of the frame before, where known, for a sharper disocclusion mask.

    >>> frame = nte.Clip("data/clips/disc_000").frame(1).torch()
    >>> vectors = nte.frame_vectors(frame)
    >>> bool(vectors.disoccluded.any())  # behind the disc, which moves
    True
    """
    forward = frame.get("previous_forward_motion")
    if forward is None:
        if "depth" not in frame:
            return traditional_motion(frame["motion"])
        forward = scatter_forward_motion(frame["motion"], frame["depth"])
    return dual_motion(frame["motion"], forward, frame.get("depth"), previous_depth)


def infinite_sky(depth: Tensor) -> Tensor:
    """Depth (N, 1, H, W) with misses, stored as 0, infinitely far: the form in which depths are compared."""
    return torch.where(depth > 0, depth, float("inf"))


def scatter_forward_motion(motion: Tensor, depth: Tensor) -> Tensor:
    """Make previous_forward_motion (N, 2, H, W) from the current frame: −motion, scattered to x + motion.

    depth (N, 1, H, W), 0 = miss, infinitely far. The nearest surface wins a pixel of the previous frame;
    pixels that nobody reaches are NaN, which dual_motion takes as «not disoccluded».

    >>> motion = torch.tensor([[-1.0, -1.0, 0.0], [0.0] * 3]).view(1, 2, 1, 3)
    >>> nte.scatter_forward_motion(motion, torch.tensor([2.0, 2.0, 5.0]).view(1, 1, 1, 3))[0, 0].tolist()
    [[1.0, nan, -0.0]]
    """
    source = traditional_motion(motion)
    target = nearest_index(pixel_centres(motion) + source.motion)
    count = target.shape[-1]
    far = torch.where(source.valid, infinite_sky(depth), float("inf")).flatten(2)
    nearest = torch.full_like(far, float("inf")).scatter_reduce(2, target, far, "amin")
    # Of several equally near pixels the last wins: one deterministic rule for every device.
    order = torch.arange(count, device=motion.device).expand_as(target)
    wins = source.valid.flatten(2) & (far == nearest.gather(2, target))
    winner = torch.full_like(target, -1).scatter_reduce(2, target, torch.where(wins, order, -1), "amax")
    forward = -source.motion.flatten(2).gather(2, winner.clamp(min=0).expand(-1, 2, -1))
    return torch.where(winner >= 0, forward, float("nan")).view_as(motion)
