"""Step 4, the first stage (section 4.3): moving and static samples, each filtered separately over 5×5 pixels."""

import torch
from torch import Tensor

from nte.filters.motion_blur.samples import COLOR, DEPTH, MOTION, MOVING, TIME, PixelList, gather, square
from nte.filters.motion_blur.weight import kernel, motion_weight

# Columns of the moving and the static buffer, which are also the history.
MOVING_COLOR, MOVING_MOTION, MOVING_WEIGHT, MOVING_ALL = slice(0, 3), slice(3, 5), 5, slice(0, 5)
STATIC_COLOR, STATIC_WEIGHT = slice(6, 9), 9
COLUMNS = 10


def first_stage(rows: Tensor, pixels: PixelList, reach: Tensor, depth_threshold: float) -> Tensor:
    """Compute the sums (K, 10) of weighted values, and of weights, in the moving and the static buffer.

    rows (N·H·W, 8): the samples. reach (K,): c_a c_l, px. depth_threshold: relative depth difference that counts as
    behind or in front. A static pixel keeps its colour; at a moving pixel the kernel fills in the static background.
    """
    own = rows[pixels.index]
    values, places, inside = gather(rows, pixels, square(2, rows.device))
    moves = inside & (values[..., MOVING] > 0)
    b3 = kernel(rows.device)
    seen = moves & ~hidden(own, values, depth_threshold)
    weight = motion_weight(pixels.centres(), places, values[..., MOTION], values[..., TIME], reach[:, None])
    weight = (b3 * weight * seen)[..., None]
    static = (b3 * (inside & ~moves & ~before(own[:, DEPTH], values, depth_threshold)))[..., None]
    behind = torch.cat([(static * values[..., COLOR]).sum(1), static.sum(1)], 1)
    kept = torch.cat([own[:, COLOR], torch.ones_like(own[:, :1])], 1)
    moving = torch.cat([values[..., COLOR], values[..., MOTION], torch.ones_like(weight)], 2)
    return torch.cat([(weight * moving).sum(1), torch.where(own[:, MOVING, None] > 0, behind, kept)], 1)


def hidden(own: Tensor, values: Tensor, depth_threshold: float) -> Tensor:
    """Mark (K, T) the samples (K, T, 8) behind the pixel's own sample (K, 8), if that is static.

    depth_threshold: the share of the pixel's depth by which a sample must be farther away.
    """
    limit = torch.where(own[:, MOVING] > 0, float("inf"), own[:, DEPTH] * (1 + depth_threshold))
    return values[..., DEPTH] > limit[:, None]


def before(depth: Tensor, values: Tensor, depth_threshold: float) -> Tensor:
    """Mark (K, T) the samples (K, T, 8) that are in front of depths (K,).

    depth_threshold: the share of the depth by which a sample must be nearer.
    """
    return values[..., DEPTH] < depth[:, None] * (1 - depth_threshold)


def normalise(sums: Tensor) -> Tensor:
    """Divide the sums (K, 10) by their weights.

    The weights stay, clamped to at most 1, as a measure of what the means are worth: 0 where there is nothing.
    """
    moving, static = sums[:, MOVING_WEIGHT, None], sums[:, STATIC_WEIGHT, None]
    return torch.cat(
        [
            sums[:, MOVING_ALL] / moving.clamp(min=1e-12),
            moving.clamp(max=1),
            sums[:, STATIC_COLOR] / static.clamp(min=1e-12),
            static.clamp(max=1),
        ],
        1,
    )
