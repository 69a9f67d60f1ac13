"""Building blocks that the analytic filters share."""

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from nte.frames.channels import TEXTURES
from nte.frames.frame import Frame
from nte.frames.usable import mask_of
from nte.motion.box import box_count, box_mean
from nte.motion.geometric import Reprojection
from nte.motion.warp import Warped, warp

MOST = 0.5  # least share of the weight that is on usable pixels of history
ROUNDING = 1e-5  # of a sum of weights that is 1
ENOUGH = 4  # least number of known pixels whose σ bounds history; a single one would replace it


def texture_of(frame: Frame, light: str) -> Tensor:
    """Return what demodulation divides a light by, (N, 3, H, W): diffuse_albedo for indirect light, else the albedo.

    The albedo counts all lobes of a surface; it takes the place of a diffuse_albedo that is missing.
    """
    own: Tensor | None = frame.get(TEXTURES.get(light, "albedo"))
    return frame["albedo"] if own is None else own


class Moments(NamedTuple):
    """Mean and standard deviation of each pixel's neighbourhood, each (N, C, H, W)."""

    mean: Tensor
    deviation: Tensor


def neighbourhood_moments(image: Tensor, size: int = 3, step: int = 1, known: Tensor | None = None) -> Moments:
    """Compute μ and σ per channel over size×size pixels around each pixel of an image (N, C, H, W).

    step: distance in px between these pixels. At the border, only the pixels that exist count. known (N, 1, H, W),
    bool: the pixels that count; None: all. Where fewer than ENOUGH of the known ones are around, σ is infinite.
    """
    # The image's mean is subtracted first: E[x²] − μ² of bright HDR values would cancel in float32.
    if known is None:
        centre = image.mean((2, 3), keepdim=True)
        away = image - centre
        mean, square = box_mean(image, size, step), box_mean(away.square_(), size, step)
        return Moments(mean, (square - (mean - centre).square_()).clamp_(min=0).sqrt_())
    counts = known.to(image.dtype)
    centre = (image * counts).sum((2, 3), keepdim=True) / counts.sum((2, 3), keepdim=True).clamp(min=1)
    parts = torch.cat([counts, image * counts, (image - centre).square_() * counts], 1)
    share, mean, square = box_mean(parts, size, step).split_with_sizes([1, image.shape[1], image.shape[1]], 1)
    exist = box_count(image, size, step)
    judged = share * exist > exist.clamp(max=ENOUGH) - 0.5
    mean, square = (part / share.clamp(min=1e-6) for part in (mean, square))
    deviation = (square - (mean - centre).square_()).clamp_(min=0).sqrt_()
    return Moments(mean, torch.where(judged, deviation, float("inf")))


def usable_moments(frame: Frame, target: str) -> Moments:
    """Compute μ and σ of 3×3 pixels of a light of the frame; bad pixels, which are black, do not count."""
    known = frame[mask_of(target)] > 0
    return neighbourhood_moments(frame[target], known=None if known.all() else known)


def clamp_history(history: Tensor, moments: Moments, width: float = 1.0) -> Tensor:
    """Clamp history (N, C, H, W), per channel, to μ ± width·σ of the current neighbourhood (Salvi 2015)."""
    reach = width * moments.deviation
    return torch.maximum(torch.minimum(history, moments.mean + reach), moments.mean - reach)


def clip_history(history: Tensor, moments: Moments, width: float = 1.0) -> Tensor:
    """Move history (N, C, H, W) along the line to μ until it lies in the box μ ± width·σ, which keeps its hue."""
    away = history - moments.mean
    outside = torch.where(away == 0, 0.0, away.abs() / (width * moments.deviation))  # infinite where σ is 0
    return moments.mean + away / outside.amax(1, keepdim=True).clamp(min=1)


def accumulate(current: Tensor, history: Tensor, valid: Tensor, alpha: float) -> Tensor:
    """Blend α·current + (1 − α)·history where history is valid, and take `current` elsewhere.

    current and history (N, C, H, W); valid (N, 1, H, W), bool; alpha: weight of the current frame.
    """
    return torch.where(valid, torch.lerp(history, current, alpha), current)


def keep_where_bad(output: Tensor, history: Tensor, valid: Tensor, frame: Frame, target: str) -> Tensor:
    """Replace the output by history, unchanged, where the current pixel is bad and history is valid.

    output and history (N, C, H, W); valid (N, 1, H, W), bool; target: the channel whose mask of usable pixels counts.
    """
    return torch.where(valid & (frame[mask_of(target)] == 0), history, output)


def remembered(output: Tensor, valid: Tensor, frame: Frame, target: str) -> Tensor:
    """Return the output (N, C, H, W) as the next frame's history, with NaN where neither frame nor history was usable.

    Those are the pixels that are bad now and have no valid history; `fetch_finite` drops them.
    """
    return torch.where(valid | (frame[mask_of(target)] > 0), output, float("nan"))


def restarts(frame: Frame) -> Tensor:
    """Return (N, 1, 1, 1) bool: true for the sequences that start with this frame, according to `frame.reset`."""
    first = frame[next(iter(frame.channels))]
    if frame.reset is None:
        return torch.zeros(frame.batch, 1, 1, 1, dtype=torch.bool, device=first.device)
    starts: Tensor = frame.reset.view(-1, 1, 1, 1) > 0
    return starts


def fetch_history(history: Tensor, reprojection: Reprojection, reset: Tensor | None) -> tuple[Tensor, Tensor]:
    """Fetch history (N, C, H, W) along the vectors, with the mask (N, 1, H, W), bool, of where it may be used.

    It may be used where it is finite, lies inside the previous frame, and its sequence does not restart.
    """
    warped, valid = fetch_finite(warp, history, reprojection.motion)
    valid = valid & reprojection.valid
    return warped, valid if reset is None else valid & ~(reset.view(-1, 1, 1, 1) > 0)


def fetch_finite(fetch: Callable[[Tensor, Tensor], Warped], history: Tensor, motion: Tensor) -> tuple[Tensor, Tensor]:
    """Fetch the pixels of history (N, C, H, W) that are finite along motion (N, 2, H, W), px, by `fetch`.

    Returns the history, and where it lies in the image and most of its weight is on finite pixels: (N, 1, H, W), bool.
    Were a NaN to spread to all pixels that it has any part in, even with a weight of 0, those of them that are bad
    would find no history and become NaN too, and if enough pixels are bad, NaN would never die out.
    """
    finite = (history.abs() < float("inf")).all(1, keepdim=True)
    if finite.all():
        return fetch(history, motion)
    past, inside = fetch(torch.cat([history.where(finite, 0.0), finite.to(history.dtype)], 1), motion)
    past, share = past[:, :-1], past[:, -1:]
    partly = (share - 1).abs() > ROUNDING  # elsewhere a batch must give the same bits as each of its sequences alone
    return past / share.where(partly & (share > MOST), 1.0), inside & (share > MOST)
