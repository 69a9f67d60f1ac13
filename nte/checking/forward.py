"""A check that forward vectors lead back: to the pixel whose own vector ends where they begin.

Where they do not, the surface was hidden in the frame before: dual vectors and disocclusion masks are made of that.
With forward vectors that are 0, or follow another convention, everything that moves seems to have been hidden. But it
may be the vectors that are wrong. Where the two disagree, the albedo of the frame that each of them leads to tells
which one is right, unless both find it there, or neither does.
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from torch import Tensor

from nte.checking.judge import EXPLAINS_GOOD
from nte.checking.textures import Textures
from nte.checking.values import Finding
from nte.checking.votes import Votes
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
TELLS = 0.2  # least share of the vectors that do not lead back that must tell which one is right
CLEARLY = 3.0  # least ratio of those that tell one thing to those that tell the other
EXPLAINED = 0.01  # greatest albedo error of a pixel that is found
NAMED = 0.8  # least share that leads back in a convention that is named

OURS = Convention()
ABLE = tuple(convention for convention in CONVENTIONS if not convention.forward)


class Returns(NamedTuple):
    """Pixels of a pair of frames that move and were seen before; their forward vectors that are 0, and lead back."""

    moving: int
    still: int
    back: Counter[Convention]  # by the convention of the forward vectors
    motion_finds: int = 0  # pixels that do not lead back whose albedo only motion finds, if most do not lead back
    forward_finds: int = 0  # those whose albedo only the forward vectors find


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
    still = int((moving & (found == 0).all(1, keepdim=True)).sum())
    finds = (0, 0)
    if back[OURS] < MOST * number and "albedo" in previous and "albedo" in current:
        finds = _who_finds(previous, current, moving & ~_leads_back(found, vectors.motion), at)
    return Returns(number, still, back, *finds)


def _who_finds(previous: Frame, current: Frame, disagree: Tensor, at: Tensor) -> tuple[int, int]:
    """Count the pixels (1, 1, H, W) of `disagree` whose albedo only motion finds, and those that only forward finds.

    at: (1, 2, H, W), where the vectors of `current` end.
    """
    back = Textures(previous, current)
    forth = Textures(current, previous.with_channels(motion=current["previous_forward_motion"]))
    pixels = (disagree.flatten() & back.usable).nonzero()[:, 0]
    vectors = at[0].flatten(1)[:, pixels] - back.centres[:, pixels]
    begin, *_ = back.target(at[0].flatten(1)[:, pixels])
    forward = current["previous_forward_motion"][0].flatten(1)[:, begin]
    ends = [back.compare(pixels, vectors, back.near), forth.compare(begin, forward, forth.near)]
    by_motion, by_forward = (tells & (error <= EXPLAINED) for error, tells in ends)
    usable = forth.usable[begin]
    return int((usable & by_motion & ~by_forward).sum()), int((usable & by_forward & ~by_motion).sum())


def judge_returns(pairs: Sequence[Returns], votes: Votes) -> Iterator[Finding]:
    """Yield a fault if most forward vectors do not lead back, and a note if some are 0 that should not be.

    It is a doubt if the picture does not tell that it is they that are wrong; and of motion, if it tells the opposite.
    pairs: of frames whose vectors are plausible; votes: all votes on these vectors.
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
    expected = "px, to the next frame; no such channel where it is unknown"
    apart = moving - back[OURS]
    by_motion, by_forward = sum(pair.motion_finds for pair in pairs), sum(pair.forward_finds for pair in pairs)
    # Wrong vectors make no others follow a convention, but one that fits them as well: if all move sideways, of y.
    named = back[fits] >= NAMED * moving and votes.good_by[fits] < EXPLAINS_GOOD * votes.good
    by_itself = still > 0.5 * moving or named
    clearly = by_motion > CLEARLY * by_forward and by_motion > TELLS * apart
    if not wrong or clearly or (by_itself and by_motion >= by_forward):
        yield Finding("forward_motion", found, expected, wrong)
    elif by_forward > CLEARLY * by_motion and by_forward > TELLS * apart:
        found = f"leads elsewhere than forward_motion, which finds its albedo, in {apart / moving:.0%} of what moves"
        yield Finding("motion", found, "vectors that lead to where forward_motion begins", False, True)
    else:
        yield Finding("forward_motion", f"{found}; or motion is wrong", expected, False, True)


def _leads_back(forward: Tensor, motion: Tensor) -> Tensor:
    return _length(forward + motion) <= NEAR_PX + SHARE * _length(motion)


def _length(vectors: Tensor) -> Tensor:
    return vectors.square().sum(1, keepdim=True).sqrt()
