"""Image pyramids, in which each level is four times smaller than the one below, together with known motion."""

from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor

SCALE = 4  # from one level to the next, along each axis
SMALLEST = 4  # px: the search on a smaller level would only look outside the image


class FewerLevelsWarning(UserWarning):
    """Warning that images are too small for the whole pyramid, so that the search misses long motions of objects."""


class Known(NamedTuple):
    """Motion that need not be searched: vectors (N, 2, H, W), px, and the mask (N, 1, H, W), bool, where they hold."""

    motion: Tensor
    mask: Tensor


class Level(NamedTuple):
    """The images (N, C, H, W) that one level compares, and the motion known there, in the level's pixels."""

    current: Tensor
    previous: Tensor
    known: Known | None


def count_levels(height: int, width: int, wanted: int) -> int:
    """Count how many of the wanted levels an image of this size has."""
    count = 1
    while count < wanted and min(height, width) >= SCALE * SMALLEST:
        height, width, count = -(-height // SCALE), -(-width // SCALE), count + 1
    return count


def pyramid(current: Tensor, previous: Tensor, known: Known | None, wanted: int) -> list[Level]:
    """Build all levels, finest first; small images (N, C, H, W) get fewer than wanted."""
    levels = [Level(current, previous, known)]
    height, width = current.shape[-2:]
    for _ in range(1, count_levels(height, width, wanted)):
        current, previous = smaller(current, SCALE), smaller(previous, SCALE)
        known = known and smaller_known(known, SCALE)
        levels.append(Level(current, previous, known))
    return levels


def smaller(image: Tensor, scale: int) -> Tensor:
    """Shrink an image (N, C, H, W) to means of scale×scale pixels.

    At the right and bottom border the mean is over the pixels that exist.
    """
    return F.avg_pool2d(image, scale, ceil_mode=True, count_include_pad=False)


def smaller_known(known: Known, scale: int) -> Known:
    """Shrink known motion to the mean of each block's known vectors, in the smaller image's pixels.

    A block is known if at least half of its pixels are.
    """
    share = smaller(known.mask.float(), scale)
    total = smaller(torch.where(known.mask, known.motion, 0.0), scale)
    return Known(total / (share.clamp(min=1e-6) * scale), share >= 0.5)


def upsample(values: Tensor, like: Tensor, scale: int) -> Tensor:
    """Enlarge values bilinearly by `scale`, cropped to the size of `like`; vectors are not rescaled."""
    height, width = like.shape[-2:]
    large = F.interpolate(values, scale_factor=scale, mode="bilinear", align_corners=False)
    return large[..., :height, :width]
