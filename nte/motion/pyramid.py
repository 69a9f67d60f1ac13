"""Images at several sizes, each level four times smaller than the one below, and known motion with them."""

from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor

SCALE = 4  # from one level to the next, along each axis
SMALLEST = 4  # px: a smaller level would search beyond the image only


class FewerLevelsWarning(UserWarning):
    """The images are too small for the whole pyramid, so long motions of single things are out of reach."""


class Known(NamedTuple):
    """Motion that need not be searched: (N, 2, H, W) in pixels, and the mask (N, 1, H, W), bool, where it holds."""

    motion: Tensor
    mask: Tensor


class Level(NamedTuple):
    """What is searched on one level, (N, C, H, W) each, and what is known there in the level's pixels."""

    current: Tensor
    previous: Tensor
    known: Known | None


def count_levels(height: int, width: int, wanted: int) -> int:
    """How many of the levels wanted an image of this size has."""
    count = 1
    while count < wanted and min(height, width) >= SCALE * SMALLEST:
        height, width, count = -(-height // SCALE), -(-width // SCALE), count + 1
    return count


def pyramid(current: Tensor, previous: Tensor, known: Known | None, wanted: int) -> list[Level]:
    """All levels, finest first; fewer than wanted if the images (N, C, H, W) are small."""
    levels = [Level(current, previous, known)]
    height, width = current.shape[-2:]
    for _ in range(1, count_levels(height, width, wanted)):
        current, previous = smaller(current, SCALE), smaller(previous, SCALE)
        known = known and smaller_known(known, SCALE)
        levels.append(Level(current, previous, known))
    return levels


def smaller(image: Tensor, scale: int) -> Tensor:
    """Means over scale×scale pixels; at the right and bottom border over those that exist."""
    return F.avg_pool2d(image, scale, ceil_mode=True, count_include_pad=False)


def smaller_known(known: Known, scale: int) -> Known:
    """Mean of the known vectors of each block, in the smaller image's pixels, where at least half of it is known."""
    share = smaller(known.mask.float(), scale)
    total = smaller(torch.where(known.mask, known.motion, 0.0), scale)
    return Known(total / (share.clamp(min=1e-6) * scale), share >= 0.5)


def upsample(values: Tensor, like: Tensor, scale: int) -> Tensor:
    """Bilinear, pixel centre to pixel centre, cropped to the size of `like`."""
    height, width = like.shape[-2:]
    large = F.interpolate(values, scale_factor=scale, mode="bilinear", align_corners=False)
    return large[..., :height, :width]
