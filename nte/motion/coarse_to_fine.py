"""The search from the coarsest level to the finest, each around what the coarser one found.

Hanika, Tessari and Dachsbacher 2021, «Fast Temporal Reprojection without Motion Vectors», section 3.1.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from nte.motion.agreement import agree
from nte.motion.box import box_mean
from nte.motion.patch_distance import REACH, best_shift, distance_along
from nte.motion.pyramid import SCALE, Known, Level, pyramid, smaller, upsample
from nte.motion.search import Search
from nte.motion.warp import fetch_along
from nte.motion.whole_shift import mean_difference, nearest_of, nearest_shift, whole_shift

_ENOUGH = 32  # least number of pixels along each axis for a reliable shift of the whole image
_SLOWEST = 8  # px of half size: slow pans are looked for from there on downwards, which reaches 28 px of full size
# Difference of half-size images under the right pan, which may be half a pixel off there, in units of that under the
# motion: at most.
_HALF_OFF = 3.0
_LARGE = 96  # px: least side of an image in which they are looked for


class Pan(NamedTuple):
    """The shift of a whole image, in px."""

    x: int
    y: int
    step: int  # px of which x and y are multiples, and to which they are known

    def times(self, unit: int) -> "Pan":
        """Return the shift in pixels that are smaller by this factor."""
        return Pan(self.x * unit, self.y * unit, self.step * unit)


class Searched(NamedTuple):
    """The result of the search in one image, in px of its finest level."""

    motion: Tensor  # (1, 2, H, W)
    pan: Pan | None  # None where the two finest levels reach the whole image's shift by themselves


def search_levels(current: Tensor, previous: Tensor, known: Known | None, search: Search) -> Searched:
    """Find the motion (1, 2, H, W), px, of one image level by level, from the coarsest to the finest.

    current and previous (1, C, H, W): finite, in the scale in which the norm compares them. Where motion is known it is
    returned as it is. A pan of the whole image is one of the motions around which the coarser levels search.
    """
    levels = pyramid(current, previous, known, len(search.radii))
    pan = _find_pan(levels)
    whole = current.new_tensor([pan.x, pan.y] if pan else [0, 0]).view(1, 2, 1, 1)
    motion: Tensor | None = None
    for level in reversed(range(len(levels))):
        motion = _search_level(levels[level], motion, whole / SCALE**level, search, level)
    assert motion is not None
    return Searched(motion, pan)


def slow_pan(now: Tensor, before: Tensor, motion: Tensor) -> Pan | None:
    """Find a pan that the two finest levels reach, if it fits the whole image better than the motion (1, 2, H, W), px.

    Patches may still have missed it, as around details of a pixel, and where a pattern repeats. now and before
    (1, C, H, W): images as `search_levels` takes them, at full size. None: nothing fits better.
    """
    if min(now.shape[-2:]) < _LARGE:
        return None
    small, small_before = smaller(now, 2), smaller(before, 2)
    x, y = nearest_shift(small, small_before, 0, 0, _SLOWEST)
    found = (small - fetch_along(small_before, smaller(motion, 2) / 2)).abs_().mean()
    if not mean_difference(small, small_before, x, y) < _HALF_OFF * found:
        return None  # at half size, a shift by an odd number of pixels fits less than well
    (x, y), difference = nearest_of(now, before, 2 * x, 2 * y)
    found = (now - fetch_along(before, motion)).abs_().mean()
    return Pan(x, y, 1) if (x or y) and difference < found else None


def settled(now: Tensor, before: Tensor, motion: Tensor, pan: Pan, search: Search, unit: int) -> Tensor:
    """Replace motion (1, 2, H, W), px, by that of a pan wherever that fits no worse.

    In nearly flat parts of a panned image, noise and rounding mislead the search by whole pixels, and around details of
    a pixel the coarse levels see nothing. The pan's motion is the median, or the whole-pixel shift that fits the image
    best: where most of it is flat, the median is that of flat parts. now and before (1, C, H, W): images as
    `search_levels` takes them, at full size. pan: in px of these. unit: side of a pixel of the search, px.
    """

    def distance_of(other: Tensor) -> Tensor:
        return distance_along(now, before, other.expand_as(motion), search.norm, unit * search.radii[0])

    middle = motion.flatten(2).median(2).values[..., None, None]
    nearest = motion.new_tensor(nearest_shift(now, before, *pan)).view_as(middle)
    fits = [(distance_of(other), other) for other in (middle, nearest)]
    distance = distance_of(motion)
    for its_distance, other in sorted(fits, key=lambda fit: -float(fit[0].mean())):  # the better one wins ties
        better = its_distance <= distance
        motion, distance = torch.where(better, other, motion), torch.where(better, its_distance, distance)
    return motion


def _find_pan(levels: list[Level]) -> Pan | None:
    """The shift of the whole image, in px of the finest level, measured in whole px of the second finest.

    None where the two finest levels reach it by themselves.
    """
    level = int(len(levels) > 1 and min(levels[1].current.shape[-2:]) >= _ENOUGH)
    now, before, _ = levels[level]
    x, y = whole_shift(now, before, farthest=0.5)
    return None if max(abs(x), abs(y)) <= REACH else Pan(x, y, 1).times(SCALE**level)


def _search_level(images: Level, coarser: Tensor | None, whole: Tensor, search: Search, level: int) -> Tensor:
    """The motion of one level, searched around the coarser level's motion, the whole image's shift, and no motion.

    Coarse levels do not show fine texture, and an error larger than the reach of the finer level cannot be corrected.
    Therefore every start is tried, and each pixel takes the best fit; the first start wins ties. The finest level,
    which costs most, uses the first start only.
    """
    now, before, known = images
    still = whole.expand(-1, -1, *now.shape[-2:])
    starts = [still] if coarser is None else [upsample(coarser, now, SCALE) * SCALE]
    if coarser is not None and level > 0:
        starts.append(still)
    if level > 0 and whole.any():  # for objects at rest before a moving background
        starts.append(torch.zeros_like(still))
    motion, distance = _search_from(now, before, starts[0], search, level)
    for start in starts[1:]:
        other, its_distance = _search_from(now, before, start, search, level)
        better = its_distance < distance
        motion, distance = torch.where(better, other, motion), torch.where(better, its_distance, distance)
    if radius := dict(enumerate(search.smoothing)).get(level, 0):
        motion = box_mean(motion, 2 * radius + 1)
    if strength := dict(enumerate(search.agreement)).get(level, 0.0):
        # The images of log norms have the gain already.
        gain = 1.0 if search.norm.startswith("log") else search.gain
        motion = agree(now, before, motion, strength, gain)
    return motion if known is None else torch.where(known.mask, known.motion, motion)


def _search_from(now: Tensor, before: Tensor, start: Tensor, search: Search, level: int) -> tuple[Tensor, Tensor]:
    """The motion and patch distance of the best shift around `start`."""
    radius, refine = search.radii[level], level < search.refined
    if not start.any():
        return best_shift(now, before, radius, search.norm, refine)
    shift, distance = best_shift(now, fetch_along(before, start), radius, search.norm, refine)
    # The best match lies at x + shift in the warped image; from there `start` leads to the previous image.
    return shift + fetch_along(start, shift), distance
