"""Step 7, the composition: moving over static, by the share of the open shutter in which something moving was seen.

Light is conserved if two things hold. The factor, summed over the image, equals the number of moving samples. And
neither side is dropped for lack of a colour: a pixel that a moving object may have crossed has a colour for it, from
as far away as the factor looked.
"""

from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor

from nte.filters.motion_blur.first_stage import (
    MOVING_COLOR,
    MOVING_MOTION,
    MOVING_WEIGHT,
    STATIC_COLOR,
    STATIC_WEIGHT,
    before,
    hidden,
)
from nte.filters.motion_blur.samples import COLOR, DEPTH, MOTION, MOVING, TIME, WINDOW, PixelList, gather
from nte.filters.motion_blur.variance import MotionStatistics, counted
from nte.filters.motion_blur.weight import motion_weight

ACROSS = 1  # px to both sides of the line of samples


class Cover(NamedTuple):
    """For K pixels: the share of the shutter that moving objects cover, and colours where the buffers have none."""

    factor: Tensor  # (K,) in [0, 1]
    moving: Tensor  # (K, 4): mean colour of the moving samples that the factor counts, and their weight
    static: Tensor  # (K, 4): mean colour of the static samples that it counts, and their weight

    @staticmethod
    def of(values: Tensor, moving: Tensor, static: Tensor) -> Tensor:
        """Compute rows (K, 9) of a cover from samples (K, T, 8) and their weights (K, T) on the two sides."""
        sums = [(weight[..., None] * values[..., COLOR]).sum(1) for weight in (moving, static)]
        covers, stands = (weight.sum(1, keepdim=True) for weight in (moving, static))
        total = (covers + stands).clamp(min=1e-12)
        means = [part / weight.clamp(min=1e-12) for part, weight in zip(sums, (covers, stands), strict=True)]
        return torch.cat([covers / total, means[0], covers, means[1], stands], 1)

    @staticmethod
    def parts(rows: Tensor) -> "Cover":
        """Split rows (K, 9) into the fields of a cover."""
        return Cover(rows[:, 0], rows[:, 1:5], rows[:, 5:9])


def plain_share(rows: Tensor, pixels: PixelList, depth_threshold: float) -> Tensor:
    """Compute rows (K, 9) of `Cover` from the share of moving samples in 15×15 pixels, as we read the paper.

    depth_threshold: relative depth difference up to which a moving sample behind a static pixel counts.
    """
    steps = torch.arange(-WINDOW, WINDOW + 1, device=rows.device)
    y, x = torch.meshgrid(steps, steps, indexing="ij")
    values, _, inside = gather(rows, pixels, torch.stack([x.flatten(), y.flatten()], 1)[None])
    cover = torch.where(rows[pixels.index, MOVING] > 0, float("inf"), rows[pixels.index, DEPTH])
    moves = counted(values[..., MOVING], values[..., DEPTH], inside, cover, depth_threshold)
    return Cover.of(values, moves.float(), (inside & (values[..., MOVING] == 0)).float())


def weighted_share(
    rows: Tensor, pixels: PixelList, sums: Tensor, estimate: MotionStatistics, reach: Tensor, depth_threshold: float
) -> Tensor:
    """Compute rows (K, 9) of `Cover` from the weighted share of moving samples, on 15 pixels along θ and 3 across.

    This is not in the paper. A moving sample whose path passes the pixel shows that something moving is seen there at
    some time. A static sample shows the opposite if it would pass the pixel with the motion of the moving object.
    Relative to that object both are samples of one line, so the weighted share is the share of the shutter, and edges
    along the motion stay sharp. Static samples in front of the moving object do not count.
    """
    along = torch.arange(-WINDOW, WINDOW + 1, device=rows.device).float()
    across = torch.arange(-ACROSS, ACROSS + 1, device=rows.device).float()
    x, y = (grid.flatten() for grid in torch.meshgrid(along, across, indexing="ij"))
    cos, sin = estimate.angle.cos()[:, None], estimate.angle.sin()[:, None]
    offsets = torch.stack([x * cos - y * sin, x * sin + y * cos], -1).round().long()
    values, places, inside = gather(rows, pixels, offsets)
    known = sums[:, MOVING_WEIGHT, None] > 0
    passing = torch.where(
        known, sums[:, MOVING_MOTION] / sums[:, MOVING_WEIGHT, None].clamp(min=1e-12), estimate.motion
    )
    moves = (values[..., MOVING] > 0) & ~hidden(rows[pixels.index], values, depth_threshold)
    motion = torch.where(moves[..., None], values[..., MOTION], passing[:, None])
    weight = motion_weight(pixels.centres(), places, motion, values[..., TIME], reach[:, None]) * inside
    moving = weight * moves
    depth = torch.where(moving > 0, moving * values[..., DEPTH], 0).sum(1) / moving.sum(1).clamp(min=1e-12)
    return Cover.of(values, moving, weight * (~moves & ~before(depth, values, depth_threshold)))


def balanced(factor: Tensor, rows: Tensor, pixels: PixelList) -> Tensor:
    """Correct the factor f (K,) so that it sums to the number of moving samples, near each pixel and in all.

    `weighted_share` looks along one direction, so it counts too many or too few samples where objects cross that move
    in several directions. The deficit near a pixel is added in proportion to f (1 − f): values of 0 and 1, and so
    edges, stay.
    """
    size = pixels.size
    seen = rows[:, MOVING].view(size.batch, 1, size.height, size.width)
    share = torch.zeros_like(seen).flatten()
    share[pixels.index] = factor
    share = share.view_as(seen)
    free = share * (1 - share)
    missing = _box((seen - share) / _box(free).clamp(min=1e-4)).clamp(-1, 1)
    return (share + missing * free).flatten()[pixels.index]


def _box(image: Tensor) -> Tensor:
    """The means of an image (N, 1, H, W) over 15×15 pixels, with 0 outside the image."""
    side = 2 * WINDOW + 1
    across = F.avg_pool2d(image, (1, side), 1, (0, WINDOW))
    return F.avg_pool2d(across, (side, 1), 1, (WINDOW, 0))


def compose(means: Tensor, cover: Cover) -> Tensor:
    """Compose colours (K, 3) from rows (K, 10) of means; the cover's colours stand in for empty buffers."""
    moving, some_moves = _either(means[:, MOVING_COLOR], means[:, MOVING_WEIGHT], cover.moving)
    static, some_stands = _either(means[:, STATIC_COLOR], means[:, STATIC_WEIGHT], cover.static)
    factor = torch.where(some_stands, cover.factor[:, None], 1.0)
    factor = torch.where(some_moves, factor, 0.0)
    return torch.lerp(static, moving, factor)


def _either(color: Tensor, weight: Tensor, spare: Tensor) -> tuple[Tensor, Tensor]:
    """The colours (K, 3) where there is weight, else the spare ones; and whether there is any (K, 1)."""
    own = weight[:, None] > 0
    return torch.where(own, color, spare[:, :3]), own | (spare[:, 3:] > 0)
