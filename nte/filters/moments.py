"""Moments of luminance over time, history length, and the variance that SVGF makes of them.

Schied et al. 2017, «Spatiotemporal Variance-Guided Filtering», sections 4.1 and 4.2.
"""

from collections.abc import Sequence

import torch
import torch.nn.functional as F
from torch import Tensor

from nte.color import luminance
from nte.filters.atrous import Edge, atrous_step

WINDOW = (1.0, 1.0, 1.0, 1.0)  # 7×7 pixels of equal weight
TILE, HALO = 32, 3


def brightness(image: Tensor) -> Tensor:
    """(N, 1, H, W): Rec. 709 luminance of a colour, a scalar image as it is."""
    return image if image.shape[1] == 1 else luminance(image)


def with_square(values: Tensor) -> Tensor:
    """First and second moment (N, 2, H, W) of one sample (N, 1, H, W) per pixel."""
    return torch.cat([values, values.square()], 1)


def lengthen(length: Tensor, valid: Tensor, longest: float) -> Tensor:
    """History length (N, 1, H, W) in frames, this one included: one more where history is valid, at most `longest`."""
    return torch.where(valid, (length + 1).clamp_(max=longest), 1.0)


def running_mean_weight(length: Tensor, floor: float) -> Tensor:
    """α of the current frame, (N, 1, H, W): 1/h is a plain mean of all frames, until `floor`."""
    return length.reciprocal().clamp_(min=floor)


def shorten(length: Tensor, change: Tensor) -> Tensor:
    """History length that is left where the weight 1/h of the current frame is pulled to lerp(1/h, 1, λ).

    The number of equally weighted frames whose mean has the same variance, 1/Σw² over the weights of all frames:
    h where λ is 0, 1 where it is 1. length h ≥ 1 and change λ in [0, 1]: (N, 1, H, W). Who forgets light and not
    its length takes the variance of one sample, which is 0, for the noise that is left.

    Other implementations shorten more: to 1/α, or, in Q2RTX, h by (1 − λ)^10. Where λ is mostly the
    noise of the gradients themselves, that gives away history: this has the least error of the three in 15 of the 18
    rows of benchmarks/asvgf.py.
    """
    pulled = 1 + change * (length - 1)  # h · lerp(1/h, 1, λ)
    return length.square() / (pulled.square() + (1 - change).square() * (length - 1))


def variance_of(moments: Tensor) -> Tensor:
    """max(0, μ₂ − μ₁²), (N, 1, H, W), of moments (N, 2, H, W)."""
    return (moments[:, 1:] - moments[:, :1].square()).clamp_(min=0)


def estimated_variance(moments: Tensor, length: Tensor, young: float, edge: Edge, guides: Sequence[Tensor]) -> Tensor:
    """Variance of luminance (N, 1, H, W): over time, but where h < `young` over 7×7 pixels, times young/h.

    moments (N, 2, H, W); edge and guides as in `atrous_step`, without luminance: which pixels show the same surface.
    Guides are 0 outside the image and must give a weight of 0 there. The spatial estimate costs
    as much as an à-trous level, but only in tiles of 32×32 that need it.
    """
    variance = variance_of(moments)
    fresh = length < young
    tiles = F.max_pool2d(fresh.float(), TILE, ceil_mode=True)[:, 0] > 0
    if not tiles.any():
        return variance
    around = atrous_step(_cut(moments, tiles), 1, edge, [_cut(g, tiles) for g in guides], kernel=WINDOW).values
    spatial = _paste(variance_of(around)[..., HALO:-HALO, HALO:-HALO], tiles, variance.shape[-2:])
    return torch.where(fresh, spatial * (young / length), variance)


def told_by_others(
    light: Tensor, moments: Tensor, known: Tensor, edge: Edge, guides: Sequence[Tensor]
) -> tuple[Tensor, Tensor]:
    """Light (N, C, H, W) and moments (N, 2, H, W), where not `known` those of the same surface in 7×7 pixels.

    known (N, 1, H, W), bool: whether the frame or its history tells anything. Unknown pixels would count as black, and
    darken what is around them. Where nothing around is known either, 0. edge and guides as in `estimated_variance`.
    """
    if known.all():
        return light, moments
    both, share = torch.cat([light, moments], 1), known.to(light.dtype)
    around = atrous_step(torch.cat([both * share, share], 1), 1, edge, guides, kernel=WINDOW).values
    found = around[:, :-1] / around[:, -1:].where(around[:, -1:] > 0, 1.0)
    both = torch.where(known, both, found)
    return both[:, :-2], both[:, -2:]


def _cut(image: Tensor, tiles: Tensor) -> Tensor:
    """The chosen tiles (T, C, 38, 38) of an image, with what surrounds them."""
    down, across = (n * TILE - size for n, size in zip(tiles.shape[1:], image.shape[-2:], strict=True))
    padded = F.pad(image, (HALO, HALO + across, HALO, HALO + down))
    windows = padded.unfold(2, TILE + 2 * HALO, TILE).unfold(3, TILE + 2 * HALO, TILE)
    return windows.permute(0, 2, 3, 1, 4, 5)[tiles]


def _paste(parts: Tensor, tiles: Tensor, size: Sequence[int]) -> Tensor:
    """The image (N, C, H, W) of tiles (T, C, 32, 32), 0 elsewhere."""
    batch, down, across = tiles.shape
    image = parts.new_zeros(batch, down, across, parts.shape[1], TILE, TILE)
    image[tiles] = parts
    whole = image.permute(0, 3, 1, 4, 2, 5).reshape(batch, -1, down * TILE, across * TILE)
    return whole[..., : size[0], : size[1]]
