"""The à-trous wavelet filter with edge-stopping weights: a 5×5 kernel whose taps lie `step` pixels apart.

Dammertz et al. 2010, «Edge-Avoiding À-Trous Wavelet Transform for fast Global Illumination Filtering»; the
kernel and the variance filtered with it are those of SVGF (Schied et al. 2017).
"""

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple, TypeAlias

import torch
from torch import Tensor

B3_SPLINE = (1.0, 2 / 3, 1 / 6)  # from the centre outwards, in x and in y
STRIP_PIXELS = 1 << 16  # processed together: a dozen planes of them stay in a core's cache

# (guides at p, guides at q, their distance in pixels) → (weight of q in p's mean, weight of p in q's mean)
Edge: TypeAlias = Callable[[Sequence[Tensor], Sequence[Tensor], float], tuple[Tensor, Tensor]]


class Filtered(NamedTuple):
    """What an à-trous step gives: weighted means (N, C, H, W), and the variance of the mean if one was given."""

    values: Tensor
    variance: Tensor | None


def atrous_step(
    values: Tensor,
    step: int,
    edge: Edge,
    guides: Sequence[Tensor],
    variance: Tensor | None = None,
    kernel: Sequence[float] = B3_SPLINE,
) -> Filtered:
    """One level: values(p) ← Σ_q h(q − p) w(p, q) values(q) / Σ_q h w, over the taps q inside the image.

    values (N, C, H, W): any number of channels, all with the same weights. guides: tensors (N, ·, H, W) that
    the weights depend on; edge(p, q, distance) is given their values at both ends of a pair of pixels, as
    slices (N, ·, h, w), and returns the two edge-stopping weights (N, 1, h, w), the same tensor twice where they
    are symmetric; a pixel's own weight is 1. variance (N, K, H, W) of the values, noise being
    independent from pixel to pixel: Σ h² w² variance / (Σ h w)² (SVGF, Eq. 4 and below).
    kernel: h along one axis from the centre outwards, beginning with 1; (1, 1, 1, 1) is a 7×7 window.

    Every unordered pair is visited once, strip by strip of rows, and gives to both of its pixels, so what is
    symmetric in an edge is computed once. Memory: the accumulators and some temporaries of a strip.
    """
    height, width = values.shape[-2:]
    total = torch.ones_like(values[:, :1])
    mean = values.clone()
    spread = None if variance is None else variance.clone()
    for here, there, weight, distance in _pairs(height, width, step, kernel, values.shape[0]):
        toward_here, toward_there = edge([g[here] for g in guides], [g[there] for g in guides], distance)
        for to, source, w in ((here, there, toward_here), (there, here, toward_there)):
            total[to].add_(w, alpha=weight)
            mean[to].addcmul_(values[source], w, value=weight)
            if spread is not None and variance is not None:
                spread[to].addcmul_(variance[source], w.square(), value=weight * weight)
    mean.div_(total)
    return Filtered(mean, None if spread is None else spread.div_(total.square_()))


_Slices: TypeAlias = tuple[slice, slice, slice, slice]


def _pairs(
    height: int, width: int, step: int, kernel: Sequence[float], batch: int
) -> Iterator[tuple[_Slices, _Slices, float, float]]:
    """(pixels p, their partners q, h, |q − p|) for each half of the kernel's offsets and each strip of rows."""
    reach = len(kernel) - 1
    rows = max(1, STRIP_PIXELS // (width * batch))
    offsets = [(y, x) for y in range(reach + 1) for x in range(-reach, reach + 1) if y > 0 or x > 0]
    every = slice(None)
    for top in range(0, height, rows):
        for y, x in offsets:
            dy, dx = y * step, x * step
            bottom = min(top + rows, height - dy)
            left, right = max(0, -dx), min(width, width - dx)
            if top < bottom and left < right:
                here = (every, every, slice(top, bottom), slice(left, right))
                there = (every, every, slice(top + dy, bottom + dy), slice(left + dx, right + dx))
                yield here, there, kernel[y] * kernel[abs(x)], step * (x * x + y * y) ** 0.5
