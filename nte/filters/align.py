"""What `align_taa` and `align_accumulate` share: motion from the images, from geometry or none, and its patch error."""

from dataclasses import replace
from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor

from nte.errors import NteError
from nte.filters.estimated import search_for
from nte.frames.frame import Frame
from nte.motion.box import box_mean
from nte.motion.correspondence import Search, find_correspondence
from nte.motion.geometric import traditional_motion
from nte.motion.warp import inside, pixel_centres, warp

MOTIONS = ("estimate", "zero", "geometric")


class Aligned(NamedTuple):
    """Where history lies, and how different the patches are there."""

    motion: Tensor  # (N, 2, H, W) pixels, current → previous, finite
    valid: Tensor  # (N, 1, H, W) bool: in the previous frame
    error: Tensor  # (N, 1, H, W) patch distance in the units of the search's norm


def check_motion(name: str, motion: str) -> None:
    """Raise NteError where a filter called `name` cannot take its motion from there."""
    if motion not in MOTIONS:
        raise NteError(f"{name}: motion is '{motion}', expected one of {', '.join(MOTIONS)}")


def check_range(name: str, **values: float) -> None:
    """Raise NteError unless 0 < alpha ≤ 1 and every other value is at least 0 and finite."""
    for key, value in values.items():
        if key == "alpha" and not 0 < value <= 1:
            raise NteError(f"{name}: alpha is {value}, expected a weight of the current frame in (0, 1]")
        if not 0 <= value < float("inf"):
            raise NteError(f"{name}: {key} is {value}, expected a number of at least 0")


def search_of(noise: str, radii: str) -> Search:
    """The search for this noise; radii as `10-4-2-2`, finest first, replace its own ("": they do not)."""
    search = search_for(noise)
    if not radii:
        return search
    try:
        return replace(search, radii=tuple(int(part) for part in radii.split("-")), error_level=0)
    except ValueError:
        raise NteError(f"radii are '{radii}', expected whole numbers, finest level first, such as 10-4-2-2") from None


def align(current: Tensor, previous: Tensor, frame: Frame, motion: str, search: Search) -> Aligned:
    """Align `previous` with `current`, (N, C, H, W) in about [0, 1], as the search compares them.

    motion: one of MOTIONS; geometric is the frame's channel. Where motion is given its patch error is measured
    with the same norm and the patches of the same level, so that rejection means the same.
    """
    if motion == "estimate":
        found = find_correspondence(current, previous, search)
        return Aligned(found.motion, inside(pixel_centres(current) + found.motion), found.error)
    if motion == "geometric":
        given = traditional_motion(frame["motion"])
        return Aligned(given.motion, given.valid, patch_error(current, previous, given.motion, search))
    still = current.new_zeros(current.shape[0], 2, *current.shape[2:])
    everywhere = torch.ones_like(still[:, :1], dtype=torch.bool)
    return Aligned(still, everywhere, patch_error(current, previous, still, search))


def patch_error(current: Tensor, previous: Tensor, motion: Tensor, search: Search) -> Tensor:
    """Patch distance (N, 1, H, W) under a motion that is given, as `find_correspondence` measures it."""
    scale = search.gain if search.norm.startswith("log") else 1.0
    warped = warp(previous, motion).image
    shrink = (2 if search.half else 1) * 4**search.error_level
    now, before = (_shrunk(image, shrink) * scale for image in (current, warped))
    difference = (now - before).abs()
    difference = difference.square() if search.norm == "l2" else difference
    difference = difference.mean(1, keepdim=True)
    if search.norm.startswith("log"):
        difference = torch.log1p(difference / 2)  # log(2 + |a − b|) − log 2
    error = box_mean(difference, 2 * search.radii[search.error_level] + 1)
    large = F.interpolate(error, scale_factor=shrink, mode="bilinear", align_corners=False)
    return large[..., : current.shape[-2], : current.shape[-1]]


def _shrunk(image: Tensor, factor: int) -> Tensor:
    return F.avg_pool2d(image, factor, ceil_mode=True, count_include_pad=False)
