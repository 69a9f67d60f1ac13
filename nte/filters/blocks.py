"""Blocks that the analytic filters share."""

from typing import NamedTuple

import torch
from torch import Tensor

from nte.frames.frame import Frame
from nte.frames.usable import mask_of
from nte.motion.box import box_mean
from nte.motion.geometric import Reprojection
from nte.motion.warp import warp


class Moments(NamedTuple):
    """Mean and standard deviation of each pixel's neighbourhood, each (N, C, H, W)."""

    mean: Tensor
    deviation: Tensor


def neighbourhood_moments(image: Tensor, size: int = 3, step: int = 1) -> Moments:
    """μ and σ per channel over size×size pixels, `step` apart; at the border over those that exist."""
    mean = box_mean(image, size, step)
    # Around the mean of each image: E[x²] − μ² of bright HDR values would cancel in float32.
    centre = image.mean((2, 3), keepdim=True)
    variance = box_mean((image - centre).square_(), size, step) - (mean - centre).square_()
    return Moments(mean, variance.clamp(min=0).sqrt())


def clamp_history(history: Tensor, moments: Moments, width: float = 1.0) -> Tensor:
    """History clamped per channel to μ ± width·σ (Salvi 2015)."""
    reach = width * moments.deviation
    return torch.maximum(torch.minimum(history, moments.mean + reach), moments.mean - reach)


def clip_history(history: Tensor, moments: Moments, width: float = 1.0) -> Tensor:
    """History moved along the line to μ until it lies in the box μ ± width·σ: keeps its hue."""
    away = history - moments.mean
    reach = (width * moments.deviation).clamp(min=1e-8)
    outside = (away.abs() / reach).amax(1, keepdim=True).clamp(min=1)
    return moments.mean + away / outside


def accumulate(current: Tensor, history: Tensor, valid: Tensor, alpha: float) -> Tensor:
    """α·current + (1 − α)·history where history is valid, else current. α weights the current frame."""
    return torch.where(valid, torch.lerp(history, current, alpha), current)


def keep_where_bad(output: Tensor, history: Tensor, valid: Tensor, frame: Frame, target: str) -> Tensor:
    """The output; where the current pixel tells nothing and history is valid, history as it is."""
    return torch.where(valid & (frame[mask_of(target)] == 0), history, output)


def remembered(output: Tensor, valid: Tensor, frame: Frame, target: str) -> Tensor:
    """The output as the next frame's history: NaN, which `fetch_history` drops, where neither of the two said
    anything: the current pixel tells nothing and had no history."""
    return torch.where(valid | (frame[mask_of(target)] > 0), output, float("nan"))


def restarts(frame: Frame) -> Tensor:
    """(N, 1, 1, 1) bool: the sequences of which this frame is the first, as it says."""
    first = frame[next(iter(frame.channels))]
    if frame.reset is None:
        return torch.zeros(frame.batch, 1, 1, 1, dtype=torch.bool, device=first.device)
    starts: Tensor = frame.reset.view(-1, 1, 1, 1) > 0
    return starts


def fetch_history(history: Tensor, reprojection: Reprojection, reset: Tensor | None) -> tuple[Tensor, Tensor]:
    """(warped history, where it may be used): finite, inside the previous frame, not in a sequence that restarts."""
    warped, valid = warp(history, reprojection.motion)
    valid = valid & reprojection.valid & (warped.abs() < float("inf")).all(1, keepdim=True)
    return warped, valid if reset is None else valid & ~(reset.view(-1, 1, 1, 1) > 0)
