"""A check for motion vectors that are 0 although the picture changes."""

from collections.abc import Sequence
from typing import NamedTuple

import torch.nn.functional as F
from torch import Tensor

from nte.frames.frame import Frame
from nte.motion.geometric import infinite_sky

LONGEST_PX = 0.5  # pixels: nearly all vectors are shorter in a frame in which nothing moves
NEARLY_ALL = 0.999  # share of the vectors
TOGETHER = 3  # least changed pixels among 3×3: motion uncovers several side by side, a noisy guide changes single ones
CHANGED = 0.01  # least share of changed pixels in a picture that changes
NEARER = 1.1  # least ratio of depths that counts as a change
ALBEDO = 0.05  # least difference of albedo that counts as a change


class Stillness(NamedTuple):
    """A pair of frames: the length that nearly all vectors stay below, in pixels, and the share of changed pixels."""

    longest: float
    changed: float


def stillness(previous: Frame, current: Frame) -> Stillness:
    """Measure the vectors of `current` and the pixels that changed since `previous`.

    Both are PyTorch frames of batch 1 with motion. Changes are seen in depth, else in instance, else in albedo, and
    are 0 without any of them. If nothing moves by a pixel, each pixel shows what one of the 3×3 pixels there showed
    before, silhouettes included; a pixel that shows something else has changed.
    """
    length = current["motion"].square().sum(1).sqrt().nan_to_num().flatten()
    longest = float(length.kthvalue(max(1, int(NEARLY_ALL * len(length)))).values)
    changed = None
    if "depth" in current and "depth" in previous:
        now, before = (infinite_sky(frame["depth"]) for frame in (current, previous))
        changed = (now > NEARER * _largest(before)) | (NEARER * now < -_largest(-before))
    elif "instance" in current and "instance" in previous:
        now, before = current["instance"], previous["instance"]
        changed = (now > _largest(before)) | (now < -_largest(-before))
    elif "albedo" in current and "albedo" in previous:
        now, before = current["albedo"], previous["albedo"]
        changed = ((now > _largest(before) + ALBEDO) | (now < -_largest(-before) - ALBEDO)).any(1)
    if changed is None:
        return Stillness(longest, 0.0)
    around = F.avg_pool2d(changed.float().view(1, 1, *current.size), 3, 1, 1) * 9  # pixels outside count as unchanged
    return Stillness(longest, float((changed.view_as(around) & (around > TOGETHER - 0.5)).float().mean()))


def without_motion(pairs: Sequence[Stillness]) -> str:
    """Say what is wrong if most pairs of frames change although vectors are below half a pixel; else return ""."""
    stuck = [pair for pair in pairs if pair.longest < LONGEST_PX and pair.changed > CHANGED]
    if not stuck or 2 * len(stuck) <= len(pairs):
        return ""
    changed, longest = max(pair.changed for pair in stuck), max(pair.longest for pair in stuck)
    return (
        f"the picture changes and the vectors do not: {changed:.1%} of the pixels show what was not within a pixel "
        f"of them in the frame before, but vectors are {longest:.2g} px long at the most"
    )


def _largest(image: Tensor) -> Tensor:
    return F.max_pool2d(image, 3, 1, 1)
