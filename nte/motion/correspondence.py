"""Motion found in the images alone, by a hierarchical patch search for where each pixel was in the previous image.

Hanika, Tessari and Dachsbacher 2021, «Fast Temporal Reprojection without Motion Vectors», section 3. The search aligns
colours and does not claim true motion; it also follows shadows, reflections, waves and clouds, whose motion cannot be
computed from geometry.
"""

import sys
import warnings
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from nte.errors import NteError
from nte.motion.coarse_to_fine import search_levels, settled, slow_pan
from nte.motion.patch_distance import distance_along
from nte.motion.pyramid import (
    SCALE,
    SMALLEST,
    FewerLevelsWarning,
    Known,
    count_levels,
    smaller,
    smaller_known,
    upsample,
)
from nte.motion.search import SEARCHES, Search, noise_of, searches_for
from nte.motion.warp import refuse_other_shape, warp

__all__ = [
    "SEARCHES", "BothWays", "Correspondence", "FewerLevelsWarning", "Known", "Search", "Searches", "find_both_ways",
    "find_correspondence", "find_motion", "noise_of", "patch_error", "rejection_mask", "searches_for",
]  # fmt: skip

_LARGEST = 1e6  # values are clamped here, so that products of their squares are finite

Searches = Search | Sequence[Search]  # one for all images of a batch, or one per image


class Correspondence(NamedTuple):
    """The motion that a search has found, and how well it fits."""

    motion: Tensor  # (N, 2, H, W) pixels, current → previous: previous = current + motion; always finite
    error: Tensor  # (N, 1, H, W) patch distance along this motion (`patch_error`), 0 for equal patches


@torch.no_grad()
def find_correspondence(
    current: Tensor, previous: Tensor, search: Searches | None = None, known: Known | None = None
) -> Correspondence:
    """Find the motion (N, 2, H, W), px, current → previous, with its patch error (N, 1, H, W).

    `find_motion` describes the arguments, and `patch_error` the error. Raises NteError for images that differ in size.
    """
    _require_sizes(current, previous)
    search = search or searches_for(current)
    motion = find_motion(current, previous, search, known)
    return Correspondence(motion, patch_error(current, previous, motion, search))


@torch.no_grad()
def find_motion(
    current: Tensor, previous: Tensor, search: Searches | None = None, known: Known | None = None
) -> Tensor:
    """Find the motion (N, 2, H, W), px, current → previous, by searching each pixel of `current` in `previous`.

    current and previous (N, C, H, W): grey images, or noise-free guides as channels. Values should have the magnitude
    of displayed ones, [0, 1], because the log norms compare them with 2. Values that are not finite count as 0, and
    those beyond ±10⁶ as that. The previous image is clamped at its border. search: one for all images, or one per
    image; None chooses one of SEARCHES for each image of `current` by its noise. known: motion that overwrites what is
    found on every level, where it is finite, and so guides the search around it.

    The motion is always finite, and the same input gives the same output. Each image of a batch is searched as if it
    were alone. Small images get fewer levels (FewerLevelsWarning). No gradients are recorded. Raises NteError for
    images or known motion that differ in size, and for a number of searches that does not fit.

    >>> previous = torch.rand(1, 1, 64, 64, generator=torch.Generator().manual_seed(0))
    >>> current = previous.roll((2, 3), (2, 3))  # two pixels down, three to the right
    >>> nte.find_motion(current, previous)[0, :, 32, 32].round().tolist()
    [-3.0, -2.0]
    """
    _require_sizes(current, previous)
    known = known and _finite(known, current)
    searches = _for_each(search or searches_for(current), current)
    for one in dict.fromkeys(one for one, _ in searches):
        _tell_of_missing_levels(current, _unit(current, one), len(one.radii))
    found = []
    for one, n in searches:
        its_known = known and Known(known.motion[n], known.mask[n])
        found.append(_find_alone(current[n], previous[n], one, its_known))
    return torch.cat(found)


def _find_alone(current: Tensor, previous: Tensor, search: Search, known: Known | None) -> Tensor:
    """The motion of one image (1, C, H, W), as `find_motion` returns it."""
    now, before = (_scaled(image, search) for image in (current, previous))
    unit = _unit(current, search)
    if unit == 1:
        motion, pan = search_levels(now, before, known, search)
    else:
        small = known and smaller_known(known, unit)
        motion, pan = search_levels(smaller(now, unit), smaller(before, unit), small, search)
        motion = upsample(motion, current, unit) * unit
    pan = slow_pan(now, before, motion) if pan is None else pan.times(unit)
    if pan is not None:
        motion = settled(now, before, motion, pan, search, unit)
    return motion if known is None else torch.where(known.mask, known.motion, motion)


@torch.no_grad()
def patch_error(current: Tensor, previous: Tensor, motion: Tensor, search: Searches) -> Tensor:
    """Compute the patch distance (N, 1, H, W) between `current` and `previous` fetched along a motion (N, 2, H, W), px.

    The motion may come from anywhere but must be finite. Norm, patches and level are those of the search, so the errors
    of found motion and of other motion can be compared. The unit is that of the norm; log 2 is subtracted from log
    distances, so that 0 means equal. search: one for all images, or one per image. Raises NteError for another number,
    and for images or a motion that differ in size.
    """
    _require_sizes(current, previous)
    refuse_other_shape("motion", motion, "current", current)
    motion = motion.float()
    return torch.cat(
        [
            _error(_scaled(current[n], one), _scaled(previous[n], one), motion[n], one)
            for one, n in _for_each(search, current)
        ]
    )


class BothWays(NamedTuple):
    """Correspondences of two images in both directions, and where they agree."""

    backward: Correspondence  # current → previous
    forward: Correspondence  # previous → current, on the pixels of the previous image
    consistent: Tensor  # (N, 1, H, W) bool, on the pixels of the current image


@torch.no_grad()
def find_both_ways(
    current: Tensor, previous: Tensor, search: Searches | None = None, tolerance: float = 1.0
) -> BothWays:
    """Find correspondences in both directions and mark where they are consistent.

    A pixel is consistent if going to the previous image and back ends within `tolerance` px of it. Disoccluded pixels
    have no correspondence and usually fail this test. One search, chosen for `current` if not given, serves both
    directions.
    """
    _require_sizes(current, previous)
    search = search or searches_for(current)
    backward = find_correspondence(current, previous, search)
    forward = find_correspondence(previous, current, search)
    there = warp(forward.motion, backward.motion)
    apart = (backward.motion + there.image).square().sum(1, keepdim=True).sqrt()
    return BothWays(backward, forward, there.valid & (apart <= tolerance))


def rejection_mask(error: Tensor, kappa: float, eta: float) -> Tensor:
    """Compute the mask m = κ ε − η (section 3.2) of the patch distance ε, (N, 1, H, W): 1 where motion is not trusted.

    The mask is clamped to [0, 1]: a negative m would raise the weight of history above the chosen one.
    """
    return (kappa * error - eta).clamp(0, 1)


def _for_each(search: Searches, images: Tensor) -> list[tuple[Search, slice]]:
    """Each image's search, with its slice of the batch. Raises NteError if the number of searches does not fit."""
    searches = [search] * len(images) if isinstance(search, Search) else list(search)
    if len(searches) != len(images):
        raise NteError(f"{len(searches)} searches for {len(images)} images: expected one, or one for each")
    return [(one, slice(n, n + 1)) for n, one in enumerate(searches)]


def _finite(known: Known, like: Tensor) -> Known:
    """Known motion in single precision, not known where it is not finite. Raises NteError for another size."""
    for name, values in known._asdict().items():
        refuse_other_shape(f"known {name}", values, "current", like)
    return Known(known.motion.float(), known.mask.bool() & known.motion.isfinite().all(1, keepdim=True))


def _unit(image: Tensor, search: Search) -> int:
    """The side, in image pixels, of one pixel of the search's finest level: 1, or 2 for a search at half size."""
    height, width = image.shape[-2:]
    return 2 if search.half and min(height, width) >= 2 * SMALLEST else 1


def _require_sizes(current: Tensor, previous: Tensor) -> None:
    """Raise NteError unless both are images (N, C, H, W) of the same size."""
    if current.shape != previous.shape or current.ndim != 4:
        raise NteError(
            f"current {tuple(current.shape)} and previous {tuple(previous.shape)}: expected two images (N, C, H, W) "
            "of one size"
        )


def _tell_of_missing_levels(image: Tensor, unit: int, wanted: int) -> None:
    """Warn (FewerLevelsWarning) if an image, searched in pixels of side `unit`, has fewer levels than wanted."""
    height, width = image.shape[-2:]
    count = count_levels(-(-height // unit), -(-width // unit), wanted)
    if count < wanted:
        reach = sum(2 * unit * SCALE**level for level in range(count))
        warnings.warn(
            f"images of {width}x{height} pixels: the search for motion uses {count} of its {wanted} levels, and misses "
            f"what moves by more than {reach} pixels against the image as a whole: if anything does, give larger "
            "images, or motion vectors",
            FewerLevelsWarning,
            stacklevel=_frames_to_the_caller(),
        )


def _frames_to_the_caller() -> int:
    """The `stacklevel` at which a warning of the calling function shows the first line outside nte and PyTorch.

    It differs with the functions that lie between, and PyTorch's decorators are among them.
    """
    frame, level = sys._getframe(1), 1
    while frame.f_back and frame.f_globals.get("__name__", "").startswith(("nte.", "torch.")):
        frame, level = frame.f_back, level + 1
    return level


def _scaled(image: Tensor, search: Search) -> Tensor:
    """Finite values, in the scale in which the norm compares them."""
    values = torch.nan_to_num(image.float(), 0, 0, 0).clamp_(-_LARGEST, _LARGEST)
    return values * search.gain if search.norm.startswith("log") else values


def _error(now: Tensor, before: Tensor, motion: Tensor, search: Search) -> Tensor:
    """The result of `patch_error` for scaled images."""
    shrink = (2 if search.half else 1) * SCALE**search.error_level
    distance = distance_along(now, before, motion, search.norm, search.radii[search.error_level], shrink)
    return upsample(distance, now, shrink)
