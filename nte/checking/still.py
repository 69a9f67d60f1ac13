"""A check for motion vectors that are 0 although the picture changes."""

from collections.abc import Sequence
from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor

from nte.frames.frame import Frame
from nte.motion.geometric import infinite_sky

LONGEST_PX = 0.5  # pixels: nearly all vectors are shorter in a frame in which nothing moves
NEARLY_ALL = 0.999  # share of the vectors
TOGETHER = 2  # pixels: side of the least block that changed alike; in noise, 4 pixels hardly ever exceed the 16 around
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
    before, silhouettes included; a pixel that shows more, or less, has changed. Motion uncovers several side by side,
    and noise changes single ones: only blocks of 2×2 pixels count.
    """
    length = current["motion"].square().sum(1).sqrt().nan_to_num().flatten()
    longest = float(length.kthvalue(max(1, int(NEARLY_ALL * len(length)))).values)
    name = next((name for name in ("depth", "instance", "albedo") if name in current and name in previous), None)
    if name is None:
        return Stillness(longest, 0.0)
    now, before = current[name], previous[name]
    if name == "depth":
        now, before = infinite_sky(now), infinite_sky(before)
        more, less = now > NEARER * _largest(before), NEARER * now < -_largest(-before)
    else:
        least = ALBEDO if name == "albedo" else 0.0
        more, less = now > _largest(before) + least, now < -_largest(-before) - least
    # Blocks of pixels that changed alike, and then the pixels of these blocks; outside nothing changed.
    blocks = -F.max_pool2d(-F.pad(torch.cat([more, less], 1).float(), (0, 1, 0, 1)), TOGETHER, 1)
    changed = F.max_pool2d(F.pad(blocks, (1, 0, 1, 0)), TOGETHER, 1).amax(1)
    return Stillness(longest, float(changed.mean()))


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
