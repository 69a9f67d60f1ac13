"""Step 5, the temporal filter (section 4.4): the previous frame's buffers, found by going back and forth."""

from typing import NamedTuple

import torch
from torch import Tensor

from nte.filters.motion_blur.first_stage import (
    FACTOR,
    MOVING_ALL,
    MOVING_MOTION,
    MOVING_WEIGHT,
    STATIC_COLOR,
    STATIC_WEIGHT,
)
from nte.filters.motion_blur.samples import Pixels, gather, in_chunks, square
from nte.filters.motion_blur.weight import kernel, motion_weight


class Reprojection(NamedTuple):
    """How history is found. shutter: its open share of the frame; accept, drop: ‖δ‖ in px."""

    iterations: int = 2
    accept: float = 0.5
    drop: float = 8.0
    shutter: float = 1.0


def find(history: Tensor, pixels: Pixels, motion: Tensor, settings: Reprojection) -> tuple[Tensor, Tensor]:
    """Offsets (K, 2) int64 from the pixels to those of the history that move to them, and where one was accepted.

    motion (K, 2): the first stage's, px over the open shutter.
    """
    p = pixels.centres()[:, 0]
    offset = -motion / settings.shutter
    accepted = torch.zeros(len(p), dtype=torch.bool, device=p.device)
    lost = motion.square().sum(1) == 0
    for _ in range(settings.iterations):
        whole = (p + offset).floor() - (p - 0.5)
        there, at, inside = (part[:, 0] for part in gather(history, pixels, whole.long()[:, None]))
        lost = lost | (~accepted & ~(inside & (there[:, MOVING_WEIGHT] > 0)))
        # δ between the half-way points, of a frame rather than of its shutter
        q = p + offset
        delta = (p - motion / settings.shutter / 2) - (q + there[:, MOVING_MOTION] / settings.shutter / 2)
        error = delta.square().sum(1)
        accepted = accepted | (~lost & (error < settings.accept**2))
        lost = lost | (~accepted & (error > settings.drop**2))
        offset = torch.where((accepted | lost)[:, None], offset, offset + delta)
    return ((p + offset).floor() - (p - 0.5)).long(), accepted


def add_history(
    sums: Tensor, history: Tensor, pixels: Pixels, reach: Tensor, settings: Reprojection, in_place: bool, weight: float
) -> tuple[Tensor, Tensor]:
    """The sums (K, 11) with those of the history rows added, and where moving history was accepted (K,).

    in_place: what is static is fetched where it stands, not along the moving samples' way.
    weight: of the history, where the current frame's kernel has 1.
    """
    motion = sums[:, MOVING_MOTION] / sums[:, MOVING_WEIGHT, None].clamp(min=1e-12)
    offset, accepted = find(history, pixels, motion, settings)

    def work(some: Pixels, chunk: Tensor) -> Tensor:
        return _fetch(history, some, offset[chunk], accepted[chunk], reach[chunk], settings, in_place)

    found = weight * in_chunks(pixels, 25, work)
    total = sums + found
    # The factor is a mean already: history counts where it has been found.
    counts = found[:, MOVING_WEIGHT].clamp(max=weight)
    factor = (sums[:, FACTOR] + found[:, FACTOR]) / (1 + counts)
    return torch.cat([total[:, :FACTOR], factor[:, None]], 1), accepted


def _fetch(
    history: Tensor, pixels: Pixels, offset: Tensor, accepted: Tensor, reach: Tensor, settings: Reprojection,
    in_place: bool,
) -> Tensor:  # fmt: skip
    """Sums (K, 11) of the history's 5×5 pixels around the found ones, each moved on by its frame, t = 0.5."""
    values, places, inside = gather(history, pixels, offset[:, None] + square(2, history.device))
    motion = values[..., MOVING_MOTION]
    now = places + motion / settings.shutter
    half = torch.full_like(now[..., 0], 0.5)
    known = inside & accepted[:, None]
    b3 = kernel(history.device)
    weight = b3 * motion_weight(pixels.centres(), now, motion, half, reach[:, None])
    weight = (weight * known * values[..., MOVING_WEIGHT])[..., None]
    own = history[pixels.index]
    if in_place:
        static = own[:, STATIC_COLOR] * own[:, STATIC_WEIGHT, None]
        static_weight = own[:, STATIC_WEIGHT, None]
    else:
        share = (b3 * known * values[..., STATIC_WEIGHT])[..., None]
        static, static_weight = (share * values[..., STATIC_COLOR]).sum(1), share.sum(1)
    total = weight.sum(1)
    return torch.cat(
        [(weight * values[..., MOVING_ALL]).sum(1), total, static, static_weight,
         (weight * values[..., FACTOR, None]).sum(1)], 1,
    )  # fmt: skip


