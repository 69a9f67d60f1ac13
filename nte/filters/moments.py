"""Moments of luminance over time, history length, and the variance that SVGF computes from them.

Schied et al. 2017, «Spatiotemporal Variance-Guided Filtering», sections 4.1 and 4.2.
"""

from collections.abc import Sequence

import torch
import torch.nn.functional as F
from torch import Tensor

from nte.color import luminance
from nte.filters.atrous import Edge, atrous_step

WINDOW = (1.0, 1.0, 1.0, 1.0)  # kernel of 7×7 pixels of equal weight
APART = (1, 4, 16)  # px between the pixels of that window, when unknown pixels are filled
ROUNDING = 1e-4  # as a share of a length: a mean of whole lengths, fetched between pixels, is less by so much at most
TILE, HALO = 32, 3  # px: side of a tile, and the margin that the window needs around it


def brightness(image: Tensor) -> Tensor:
    """Compute the Rec. 709 luminance (N, 1, H, W) of a colour image; an image with one channel is returned as it is."""
    return image if image.shape[1] == 1 else luminance(image)


def with_square(values: Tensor) -> Tensor:
    """Make the first and second moment (N, 2, H, W) of one sample (N, 1, H, W) per pixel."""
    return torch.cat([values, values.square()], 1)


def lengthen(length: Tensor, valid: Tensor, longest: float) -> Tensor:
    """Count this frame in the history length (N, 1, H, W): one more where history is valid, at most `longest`, else 1.

    valid (N, 1, H, W), bool.
    """
    return torch.where(valid, (length + 1).clamp_(max=longest), 1.0)


def running_mean_weight(length: Tensor, floor: float) -> Tensor:
    """Compute the current frame's weight α (N, 1, H, W): 1/h, a plain mean of all frames, but at least `floor`."""
    return length.reciprocal().clamp_(min=floor)


def shorten(length: Tensor, change: Tensor) -> Tensor:
    """Compute the history length that is left when λ pulls the current frame's weight from 1/h to lerp(1/h, 1, λ).

    length h ≥ 1 and change λ in [0, 1]: (N, 1, H, W). The result is 1/Σw² over the weights w of all frames, that is the
    number of equally weighted frames whose mean has the same variance: h where λ is 0, and 1 where λ is 1. A filter
    that drops light but keeps its length would take the variance of one sample, which is 0, for the noise that is left.

    Other implementations shorten more: to 1/α, or, in Q2RTX, h by (1 − λ)^10. Where λ is mostly the noise of the
    gradients themselves, that drops too much history: this rule has the least error of the three in 15 of 18 measured
    cases.
    """
    pulled = 1 + change * (length - 1)  # this is h · lerp(1/h, 1, λ)
    return length.square() / (pulled.square() + (1 - change).square() * (length - 1))


def variance_of(moments: Tensor) -> Tensor:
    """Compute max(0, μ₂ − μ₁²), (N, 1, H, W), from moments (N, 2, H, W)."""
    return (moments[:, 1:] - moments[:, :1].square()).clamp_(min=0)


def estimated_variance(moments: Tensor, length: Tensor, young: float, edge: Edge, guides: Sequence[Tensor]) -> Tensor:
    """Estimate the variance of luminance (N, 1, H, W): over time, or, where h < `young`, over 7×7 pixels times young/h.

    moments (N, 2, H, W); length h (N, 1, H, W). edge and guides: as in `atrous_step`, without luminance; they tell
    which pixels show the same surface. Guides are padded with 0 outside the image and must give a weight of 0 there.
    The spatial estimate costs as much as an à-trous level, but only in those tiles of 32×32 that need it.
    """
    variance = variance_of(moments)
    fresh = length < young * (1 - ROUNDING)  # or rounding would decide in every pixel in which history begins to count
    tiles = F.max_pool2d(fresh.float(), TILE, ceil_mode=True)[:, 0] > 0
    if not tiles.any():
        return variance
    around = atrous_step(_cut(moments, tiles), 1, edge, [_cut(g, tiles) for g in guides], kernel=WINDOW).values
    spatial = _paste(variance_of(around)[..., HALO:-HALO, HALO:-HALO], tiles, variance.shape[-2:])
    return torch.where(fresh, spatial * (young / length), variance)


def told_by_others(
    light: Tensor, moments: Tensor, known: Tensor, edge: Edge, guides: Sequence[Tensor]
) -> tuple[Tensor, Tensor]:
    """Fill light (N, C, H, W) and moments (N, 2, H, W) where they are not `known`, from the same surface nearby.

    known (N, 1, H, W), bool: whether the frame or its history is usable. Unknown pixels would count as black and darken
    their neighbours. They take the mean of 7×7 pixels, which lie farther apart where nothing nearer is known, about as
    far as the five levels of the à-trous filter reach. What is still unknown then is 0. edge and guides: as in
    `estimated_variance`.
    """
    if known.all():
        return light, moments
    both = torch.cat([light, moments], 1)
    for step in APART:
        share = known.to(light.dtype)
        around = atrous_step(torch.cat([both * share, share], 1), step, edge, guides, kernel=WINDOW).values
        found, share = around[:, :-1], around[:, -1:]
        both = torch.where(known, both, found / share.where(share > 0, 1.0))
        known = known | (share > 0)
        if known.all():
            break
    return both[:, :-2], both[:, -2:]


def _cut(image: Tensor, tiles: Tensor) -> Tensor:
    """The chosen tiles (T, C, 38, 38) of an image, with their margins."""
    down, across = (n * TILE - size for n, size in zip(tiles.shape[1:], image.shape[-2:], strict=True))
    padded = F.pad(image, (HALO, HALO + across, HALO, HALO + down))
    windows = padded.unfold(2, TILE + 2 * HALO, TILE).unfold(3, TILE + 2 * HALO, TILE)
    return windows.permute(0, 2, 3, 1, 4, 5)[tiles]


def _paste(parts: Tensor, tiles: Tensor, size: Sequence[int]) -> Tensor:
    """The image (N, C, H, W) made of tiles (T, C, 32, 32), 0 elsewhere."""
    batch, down, across = tiles.shape
    image = parts.new_zeros(batch, down, across, parts.shape[1], TILE, TILE)
    image[tiles] = parts
    whole = image.permute(0, 3, 1, 4, 2, 5).reshape(batch, -1, down * TILE, across * TILE)
    return whole[..., : size[0], : size[1]]
