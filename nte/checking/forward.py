"""A check that forward vectors lead back: to the pixel whose own vector ends where they begin.

Where they do not, the surface was hidden in the frame before: dual vectors and disocclusion masks are made of that.
With forward vectors that are 0, or follow another convention, everything that moves seems to have been hidden.
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from torch import Tensor

from nte.checking.values import Finding
from nte.frames.frame import Frame
from nte.motion.conventions import CONVENTIONS, Convention
from nte.motion.geometric import infinite_sky, traditional_motion
from nte.motion.warp import fetch_nearest, pixel_centres

MOVING_PX = 1.0  # shorter vectors tell nothing
NEAR_PX, SHARE = 0.5, 0.1  # a vector leads back if it misses by at most so many pixels and that share of its length
SAME_SURFACE = 1.1  # greatest ratio of the depths at both ends of a vector
ENOUGH = 200  # least number of pixels that can tell
MOST = 0.5  # the forward vectors are wrong if a smaller share of them leads back
SOME = 0.1  # a greater share of zeros where something moves is told
NAMED = 0.8  # least share that leads back in a convention that is named

OURS = Convention()
ABLE = tuple(convention for convention in CONVENTIONS if not convention.forward)


class Returns(NamedTuple):
    """Pixels of a pair of frames that move and were seen before; their forward vectors that are 0, and lead back."""

    moving: int
    still: int
    back: Counter[Convention]  # by the convention of the forward vectors


def returns(previous: Frame, current: Frame) -> Returns | None:
    """Follow the vectors of `current` to the frame before, and the forward vectors from there; None without these.

    Both are PyTorch frames of batch 1 with motion; depth is optional.
    """
    forward = current.get("previous_forward_motion")
    if forward is None:
        return None
    vectors = traditional_motion(current["motion"])
    at = pixel_centres(vectors.motion) + vectors.motion
    moving = vectors.valid & (_length(vectors.motion) > MOVING_PX)
    if "depth" in previous and "depth" in current:
        now, before = infinite_sky(current["depth"]), infinite_sky(fetch_nearest(previous["depth"], at))
        moving &= (now <= SAME_SURFACE * before) & (before <= SAME_SURFACE * now)
    found = fetch_nearest(forward, at)
    number, back = int(moving.sum()), Counter[Convention]()
    for convention in ABLE:  # the first is ours
        leads = _leads_back(convention.convert(found, found, found), vectors.motion)
        back[convention] = int((moving & leads).sum())
        if back[OURS] >= MOST * number:
            break
    return Returns(number, int((moving & (found == 0).all(1, keepdim=True)).sum()), back)


def judge_returns(pairs: Sequence[Returns]) -> Iterator[Finding]:
    """Yield a fault if most forward vectors do not lead back, and a note if some are 0 that should not be.

    pairs: of frames whose vectors are plausible.
    """
    moving, still = sum(pair.moving for pair in pairs), sum(pair.still for pair in pairs)
    back: Counter[Convention] = sum((pair.back for pair in pairs), Counter())
    wrong = back[OURS] < MOST * moving
    if moving < ENOUGH or not (wrong or still > SOME * moving):
        return
    fits = max(ABLE, key=lambda convention: back[convention])
    found = f"leads back from where motion leads in {back[OURS] / moving:.0%} of the moving pixels"
    if not wrong or still > 0.5 * moving:
        found = f"0 where motion is not, in {still / moving:.0%} of the moving pixels"
    elif back[fits] >= NAMED * moving:
        found = f"has another convention: {fits}"
    yield Finding("forward_motion", found, "px, to the next frame; no such channel where it is unknown", wrong)


def _leads_back(forward: Tensor, motion: Tensor) -> Tensor:
    return _length(forward + motion) <= NEAR_PX + SHARE * _length(motion)


def _length(vectors: Tensor) -> Tensor:
    return vectors.square().sum(1, keepdim=True).sqrt()
