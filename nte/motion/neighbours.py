"""Pixels and their neighbours."""

import torch
from torch import Tensor

_BENT = 4.0  # most that a step within one surface is taken to exceed the next one; curved surfaces flatten quickly


def pairs(image: Tensor, axis: int, k: int) -> tuple[Tensor, Tensor]:
    """Return views of all pairs of pixels k steps apart along an axis: the first pixels, and the second ones."""
    count = image.shape[axis] - k
    return image.narrow(axis, 0, count), image.narrow(axis, k, count)


def own_step(steps: Tensor, axis: int) -> Tensor:
    """Find the change from pixel to pixel within each pixel's own surface.

    steps (N, C, …, L − 1 along the axis): the changes from each pixel to the next, infinite where they show nothing in
    common. Returns (N, C, …, L): the smaller of the steps to both sides, which at an edge is the surface's own, and
    0 where both are infinite. It is at most four times the step that follows: a thing that is one pixel wide has edges
    on both sides, and what lies behind them says so.
    """
    nothing = torch.full_like(steps.narrow(axis, 0, 1), float("inf"))
    ahead, behind = torch.cat([steps, nothing], axis), torch.cat([nothing, steps], axis)
    count = steps.shape[axis]
    after = torch.cat([ahead.narrow(axis, 1, count), nothing], axis)
    before = torch.cat([nothing, behind.narrow(axis, 0, count)], axis)
    forth = ahead.abs() < behind.abs()
    step = torch.where(forth, ahead, behind)
    most = torch.where(forth, after, before).abs_().mul_(_BENT)
    return step.clamp(-most, most).where(step.abs() < float("inf"), 0.0)
