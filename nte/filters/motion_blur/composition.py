"""Step 7, the composition: moving over static, by how much of the open shutter something moving was seen."""

import torch
from torch import Tensor

from nte.filters.motion_blur.first_stage import (
    FACTOR,
    MOVING_COLOR,
    MOVING_MOTION,
    MOVING_WEIGHT,
    STATIC_COLOR,
    STATIC_WEIGHT,
    hidden,
)
from nte.filters.motion_blur.samples import MOTION, MOVING, TIME, WINDOW, Pixels, gather
from nte.filters.motion_blur.variance import Estimate
from nte.filters.motion_blur.weight import motion_weight

ACROSS = 1  # px to both sides of the line that is looked at


def weighted_share(
    rows: Tensor, pixels: Pixels, sums: Tensor, estimate: Estimate, reach: Tensor, depth_threshold: float
) -> Tensor:
    """(K,): the w-weighted share of moving samples on 15 pixels along θ and 3 across; ours.

    A moving sample whose way passes the pixel says that something moving is seen there at some time. A static one
    says as much of nothing, if it would pass with the motion of what moves here: in the frame of the moving thing
    both are samples of one line, so the share is that of the shutter, and edges along the motion stay sharp.
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
    total = weight.sum(1)
    return torch.where(total > 0, (weight * moves).sum(1) / total.clamp(min=1e-12), estimate.share)


def compose(means: Tensor) -> Tensor:
    """(K, 3): colours of rows (K, 11); what is missing on one side is all of the other."""
    factor = means[:, FACTOR, None].clamp(0, 1)
    factor = torch.where(means[:, STATIC_WEIGHT, None] > 0, factor, 1.0)
    factor = torch.where(means[:, MOVING_WEIGHT, None] > 0, factor, 0.0)
    return torch.lerp(means[:, STATIC_COLOR], means[:, MOVING_COLOR], factor)
