"""The à-trous wavelet filter with edge-stopping weights: a 5×5 kernel whose taps lie `step` pixels apart.

Dammertz et al. 2010, «Edge-Avoiding À-Trous Wavelet Transform for fast Global Illumination Filtering»; the kernel, and
the filtering of the variance, are those of SVGF (Schied et al. 2017).
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from itertools import pairwise, product
from typing import NamedTuple, TypeAlias

import torch
from torch import Tensor

from nte.filters.threads import side_by_side, threads_for
from nte.motion.warp import refuse_other_shape

B3_SPLINE = (1.0, 2 / 3, 1 / 6)  # from the centre outwards, in x and in y
STRIP_PIXELS = 1 << 17  # pixels processed together, of which a dozen planes fit into a core's cache

# (guides at p, guides at q, their distance in pixels) → (weight of q in p's mean, weight of p in q's mean)
Edge: TypeAlias = Callable[[Sequence[Tensor], Sequence[Tensor], float], tuple[Tensor, Tensor]]


class Filtered(NamedTuple):
    """The result of an à-trous step: weighted means (N, C, H, W), and the variance of the mean if one was given."""

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
    """Filter one level: values(p) ← Σ_q h(q − p) w(p, q) values(q) / Σ_q h w, over the taps q inside the image.

    values (N, C, H, W): any number of channels, all filtered with the same weights. step: distance between taps, px.
    guides: tensors (N, ·, H, W) that the weights depend on. edge(p, q, distance) receives their values at both ends of
    a pair of pixels, as slices (N, ·, h, w), and returns the two edge-stopping weights (N, 1, h, w), or the same tensor
    twice if they are symmetric; a pixel's own weight is 1. variance (N, K, H, W): of the values, with noise independent
    from pixel to pixel; it becomes Σ h² w² variance / (Σ h w)² (SVGF, section 4.3). kernel: h along one axis from
    the centre outwards, beginning with 1; (1, 1, 1, 1) is a 7×7 window.

    Every unordered pair is visited once, strip by strip of rows, and contributes to both of its pixels, so that
    symmetric parts of an edge are computed once. Memory: the sums, and some temporaries of a strip for each thread.
    Raises NteError for guides or a variance of another size than the values.
    """
    for name, image in (*(("a guide", guide) for guide in guides), ("the variance", variance)):
        refuse_other_shape(name, image, "values", values)
    total = torch.ones_like(values[:, :1])
    mean = values.clone()
    spread = None if variance is None else variance.clone()

    def add(pairs: Iterable[_Pair]) -> None:
        for here, there, weight, distance in pairs:
            toward_here, toward_there = edge([here(g) for g in guides], [there(g) for g in guides], distance)
            for to, source, w in ((here, there, toward_here), (there, here, toward_there)):
                to(total).add_(w, alpha=weight)
                to(mean).addcmul_(source(values), w, value=weight)
                if spread is not None and variance is not None:
                    to(spread).addcmul_(source(variance), w.square(), value=weight * weight)

    threads = threads_for(values)
    within, across = _pairs(values.shape, step, kernel, threads)
    side_by_side([partial(add, pairs) for pairs in within], threads)
    add(across)
    mean.div_(total)
    return Filtered(mean, None if spread is None else spread.div_(total.square_()))


class _Window(NamedTuple):
    """A rectangle of some images of a batch; calling it cuts the rectangle out of a tensor (N, C, H, W), as a view."""

    first: int
    images: int
    top: int
    rows: int
    left: int
    columns: int

    def __call__(self, tensor: Tensor) -> Tensor:
        if self.images < len(tensor):
            tensor = tensor.narrow(0, self.first, self.images)
        # Half the time of slicing with brackets, which matters: a window is cut fifteen times for each pair.
        return tensor.narrow(2, self.top, self.rows).narrow(3, self.left, self.columns)


_Pair: TypeAlias = tuple[_Window, _Window, float, float]  # pixels p, their partners q, h, |q − p|


def _pairs(
    shape: Sequence[int], step: int, kernel: Sequence[float], threads: int
) -> tuple[list[Iterator[_Pair]], Iterator[_Pair]]:
    """All pairs of the kernel's half: those within each band of rows, strip by strip, and those between bands.

    Bands, of different images or different rows, share no pixel, so they can be filtered at the same time.
    """
    batch, _, height, width = shape
    group = min(batch, max(1, STRIP_PIXELS // (height * width)))  # small images are filtered together
    strip = max(1, STRIP_PIXELS // (width * group))
    reach = len(kernel) - 1
    offsets = [(y, x) for y in range(reach + 1) for x in range(-reach, reach + 1) if y > 0 or x > 0]
    bands = max(1, min(threads, height // (4 * reach * step)))
    borders = [height * band // bands for band in range(bands + 1)]

    def cut(first: int, top: int, bottom: int, y: int, x: int) -> Iterator[_Pair]:
        """Yield the pairs of one offset whose upper pixels are in these rows."""
        dy, dx = y * step, x * step
        columns = width - abs(dx)
        if bottom > top and columns > 0:
            images = min(group, batch - first)
            here = _Window(first, images, top, bottom - top, max(0, -dx), columns)
            there = _Window(first, images, top + dy, bottom - top, max(0, dx), columns)
            yield here, there, kernel[y] * kernel[abs(x)], step * (x * x + y * y) ** 0.5

    def inside(first: int, start: int, end: int) -> Iterator[_Pair]:
        for top, (y, x) in product(range(start, end, strip), offsets):
            yield from cut(first, top, min(top + strip, end - y * step), y, x)

    def between() -> Iterator[_Pair]:
        for first, (start, end), (y, x) in product(range(0, batch, group), pairwise(borders), offsets):
            yield from cut(first, max(start, end - y * step), min(end, height - y * step), y, x)

    images = range(0, batch, group)
    return [inside(first, start, end) for first in images for start, end in pairwise(borders)], between()
