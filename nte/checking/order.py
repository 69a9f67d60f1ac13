"""A check that what is nearer hides what is behind it: an inverse depth, as in many z-buffers, turns that around."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import torch.nn.functional as F
from torch import Tensor

from nte.checking.values import Finding
from nte.frames.frame import Frame
from nte.motion.geometric import traditional_motion
from nte.motion.warp import fetch_nearest, pixel_centres

APART = 1.2  # least ratio of the depths of two instances
TWICE = 2.0  # the same where instances are unknown: a fast camera changes the depth of one surface by less in a frame
ENOUGH = 20  # least number of pixels that can tell
MOST = 0.9  # share of them that must agree


class Order(NamedTuple):
    """Pixels whose surface was hidden in the frame before: by something nearer, and by something farther."""

    nearer: int
    farther: int


def depth_order(previous: Frame, current: Frame) -> Order:
    """Count the pixels of `current` whose vectors lead to another surface in `previous`, nearer or farther than theirs.

    Both are PyTorch frames of batch 1 with motion and depth; `instance` is optional. All 3×3 pixels at both ends of a
    vector must agree: thin parts show in one frame and not in the next without being hidden.
    """
    vectors = traditional_motion(current["motion"])
    at = pixel_centres(current["motion"]) + vectors.motion
    low, high = _range(current["depth"])
    low_before, high_before = (fetch_nearest(depth, at) for depth in _range(previous["depth"]))
    tells, apart = vectors.valid & (low > 0) & (low_before > 0), TWICE
    if "instance" in current and "instance" in previous:
        tells, apart = tells & (fetch_nearest(previous["instance"], at) != current["instance"]), APART
    nearer, farther = tells & (apart * high_before < low), tells & (low_before > apart * high)
    return Order(int(nearer.sum()), int(farther.sum()))


def judge_order(pairs: Sequence[Order]) -> Iterator[Finding]:
    """Yield a fault if nearly everything that hides something is farther away, in most pairs of frames.

    After a cut to a close-up, or where an object appears from nowhere, everything near is in front of what was far, in
    that pair: two pairs at least must agree, unless there is only one. pairs: of frames whose vectors are plausible, as
    others lead anywhere.
    """
    telling = [pair for pair in pairs if sum(pair)]
    wrong = [pair for pair in telling if pair.farther > MOST * sum(pair)]
    farther, pixels = sum(pair.farther for pair in wrong), sum(map(sum, wrong))
    if pixels >= ENOUGH and 2 * len(wrong) > len(telling) and len(wrong) >= min(2, len(pairs)):
        count = f"in {farther} of {pixels} pixels"
        found = f"what hides is farther away than what it hides, {count}: inverse depth, as in a z-buffer"
        yield Finding("depth", found, "the distance along the view axis, in scene units")


def _range(depth: Tensor) -> tuple[Tensor, Tensor]:
    """Smallest and largest depth among the 3×3 pixels around each; (1, 1, H, W)."""
    return -F.max_pool2d(-depth, 3, 1, 1), F.max_pool2d(depth, 3, 1, 1)
