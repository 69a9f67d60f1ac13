"""Step 1, the variance estimate (section 4.1): mean and variance of length and direction of the motion near a pixel.

It runs at half resolution: the four pixels of a 2×2 tile share the estimate over the 16×16 pixels that their 15×15
windows cover.
"""

import math
from typing import NamedTuple

import torch
from torch import Tensor

from nte.filters.motion_blur.samples import DEPTH, MOTION, MOVING, WINDOW, PixelList, gather, in_chunks


class MotionStatistics(NamedTuple):
    """Statistics of the moving samples near each of K pixels, each (K,) unless noted."""

    length: Tensor  # l: mean ‖v‖, px; 0 where no sample moves
    length_variance: Tensor  # px²
    angle: Tensor  # θ: mean direction, radians, where opposite directions are the same
    angle_variance: Tensor  # divided by (π/2)², in [0, 1]
    motion: Tensor  # (K, 2): vector of the moving sample nearest to the tile's centre, px

    def reach(self, angle: float, length: float) -> Tensor:
        """Compute c_a c_l (K,), px, from β_a and β_l: how far from its path a sample still counts."""
        wide = 1 + (angle * self.angle_variance).clamp(max=1)
        return wide * (1 + (length * self.length_variance).clamp(max=1))

    def some(self, which: Tensor) -> "MotionStatistics":
        """Return the statistics of the pixels at these positions of the list."""
        return MotionStatistics(*(values[which] for values in self))


def estimate_variance(rows: Tensor, pixels: PixelList, depth_threshold: float, naive: bool = False) -> MotionStatistics:
    """Estimate the motion statistics near each of the pixels from the rows of samples.

    depth_threshold: a moving sample that is farther behind a static tile than this share of its depth does not count,
    so that edges of an occluder stay sharp. naive: average angles in [0, 2π) as they are (the paper's Fig. 3, left).
    """
    tiles, of_pixel = _tiles(pixels)
    motion = rows[:, MOTION]
    angle = torch.atan2(motion[:, 1], motion[:, 0])
    # Four columns instead of eight, since reading them dominates the cost of the estimate.
    narrow = torch.stack([motion.square().sum(1).sqrt(), angle, rows[:, DEPTH], rows[:, MOVING]], 1)
    table = in_chunks(tiles, 16**2, lambda some, _: _tile_statistics(narrow, some, depth_threshold, naive))[of_pixel]
    length, length_variance, angle, angle_variance = table[:, :4].unbind(1)
    return MotionStatistics(length, length_variance, angle, angle_variance, table[:, 4:])


def _tiles(pixels: PixelList) -> tuple[PixelList, Tensor]:
    """The 2×2 tiles (their upper left pixels) that contain the pixels, and the tile (K,) of each pixel."""
    width = pixels.size.width
    upper_left = pixels.index - pixels.x % 2 - pixels.y % 2 * width
    index, of_pixel = torch.unique(upper_left, return_inverse=True)
    return PixelList.at(index, pixels.size), of_pixel


def _window(device: torch.device) -> Tensor:
    """The offsets (1, 256, 2) from the upper left pixel of a tile, nearest to the tile's centre first."""
    steps = torch.arange(-WINDOW, WINDOW + 2, device=device)
    y, x = torch.meshgrid(steps, steps, indexing="ij")
    offsets = torch.stack([x.flatten(), y.flatten()], 1)
    order = ((offsets - 0.5).square().sum(1)).sort(stable=True).indices
    return offsets[order][None]


def _tile_statistics(narrow: Tensor, tiles: PixelList, depth_threshold: float, naive: bool) -> Tensor:
    """The rows (K, 6) of `MotionStatistics`, from rows (M, 4) of samples: length, angle, depth, moving."""
    values, _, inside = gather(narrow, tiles, _window(narrow.device))
    lengths, angles, depth, moves = values.unbind(-1)
    own = inside[:, :4] & (moves[:, :4] > 0)
    # Depth of the static surface that covers the tile; infinite if the tile moves itself.
    cover = torch.where(inside[:, :4] & ~own, depth[:, :4], 0).amax(1)
    cover = torch.where(own.any(1), float("inf"), cover)
    moving = counted(moves, depth, inside, cover, depth_threshold)
    number = torch.arange(moving.shape[1], device=narrow.device)
    first = torch.where(moving, number, len(number)).amin(1).clamp(max=len(number) - 1)
    there = torch.arange(len(first), device=narrow.device), first
    direction, speed = angles[there], lengths[there]
    reference = torch.stack([speed * direction.cos(), speed * direction.sin()], 1)
    length, length_variance = _moments(lengths, moving)
    start = torch.zeros_like(length) if naive else direction
    relative = angles % (2 * math.pi) if naive else angles - start[:, None]
    if not naive:  # angles outside ±90° are flipped by 180°
        relative = relative - math.pi * (relative / math.pi).round()
    mean, angle_variance = _moments(relative, moving)
    normalised = (angle_variance / (math.pi / 2) ** 2).clamp(max=1)
    some = moving.any(1, keepdim=True)
    table = torch.stack([length, length_variance, start + mean, normalised], 1)
    return torch.where(some, torch.cat([table, reference], 1), 0)


def counted(moves: Tensor, depth: Tensor, inside: Tensor, cover: Tensor, depth_threshold: float) -> Tensor:
    """Mark (K, T) the moving samples that are not behind the static cover (K,) of the pixel.

    depth_threshold: the share of the cover's depth by which a sample may be farther away.
    """
    return inside & (moves > 0) & (depth <= (cover * (1 + depth_threshold))[:, None])


def _moments(values: Tensor, counted: Tensor) -> tuple[Tensor, Tensor]:
    """The mean and variance (K,) of the values (K, T) that are counted; 0 where none is."""
    number = counted.sum(1).clamp(min=1)
    mean = torch.where(counted, values, 0).sum(1) / number
    return mean, torch.where(counted, values - mean[:, None], 0).square().sum(1) / number
