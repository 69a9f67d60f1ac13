"""Step 6, the second stage (section 4.3): an à-trous filter along the motion, in the moving buffer only."""

import torch
from torch import Tensor

from nte.filters.motion_blur.first_stage import MOVING_ALL, MOVING_MOTION, MOVING_WEIGHT
from nte.filters.motion_blur.samples import PixelList, gather, in_chunks, square
from nte.filters.motion_blur.variance import MotionStatistics
from nte.filters.motion_blur.weight import kernel, motion_weight

ITERATIONS = 3


def second_stage(
    buffer: Tensor, pixels: PixelList, estimate: MotionStatistics, reach: Tensor, stretch: float | None
) -> Tensor:
    """Filter the moving buffer (rows (N·H·W, 6): colour, vector, weight) at the pixels, for which l > 0.

    reach: c_a c_l of these pixels, px. stretch: factor of the steps along θ, 1 in the paper; None: à-trous steps
    2^(i−1) along the axes of the image, instead of steps that are scaled by l and rotated to θ.
    """
    rows = buffer
    for i in range(1, ITERATIONS + 1):
        offsets = fixed_steps(i, rows.device) if stretch is None else scaled_steps(estimate, i, stretch)

        def work(some: PixelList, chunk: Tensor, rows: Tensor = rows, offsets: Tensor = offsets) -> Tensor:
            return _filter(rows, some, offsets if len(offsets) == 1 else offsets[chunk], reach[chunk])

        filtered = in_chunks(pixels, 25, work)
        rows = rows.clone()
        rows[pixels.index] = filtered
    return rows


def fixed_steps(iteration: int, device: torch.device) -> Tensor:
    """Return the whole-pixel offsets (1, 25, 2) of the original à-trous transform."""
    return square(2, device) << (iteration - 1)


def scaled_steps(estimate: MotionStatistics, iteration: int, stretch: float = 1.0) -> Tensor:
    """Compute whole-pixel offsets (K, 25, 2) by s_x = (1/5)·l/2^(3−i) along θ and s_y = lerp(1, s_x, σ²_θ) across.

    stretch: factor of s_x.
    """
    along = stretch * estimate.length / 5 / 2 ** (ITERATIONS - iteration)
    across = torch.lerp(torch.ones_like(along), along, estimate.angle_variance)
    steps = square(2, along.device)[0].float()
    x, y = steps[:, 0] * along[:, None], steps[:, 1] * across[:, None]
    cos, sin = estimate.angle.cos()[:, None], estimate.angle.sin()[:, None]
    return torch.stack([x * cos - y * sin, x * sin + y * cos], -1).round().long()


def _filter(rows: Tensor, pixels: PixelList, offsets: Tensor, reach: Tensor) -> Tensor:
    values, places, inside = gather(rows, pixels, offsets)
    motion = values[..., MOVING_MOTION]
    half = torch.full_like(motion[..., 0], 0.5)
    weight = kernel(rows.device) * motion_weight(pixels.centres(), places, motion, half, reach[:, None])
    weight = weight * (inside & (values[..., MOVING_WEIGHT] > 0))
    total = weight.sum(1, keepdim=True)
    mean = (weight[..., None] * values[..., MOVING_ALL]).sum(1) / total.clamp(min=1e-12)
    return torch.where(total > 0, torch.cat([mean, total], 1), rows[pixels.index])
