"""By how much the whole image has moved: phase correlation proposes, and the median difference decides.

Kuglin and Hines 1975, «The Phase Correlation Image Alignment Method».
"""

import torch
import torch.nn.functional as F
from torch import Tensor

_PEAKS = 16  # of the phase correlation that are tried
_FRACTION = 1 / 3  # of the means' spacing: a pixel
_BETTER = 0.9  # times the difference of what was best so far: a shift that fits only as well is none


def whole_shift(current: Tensor, previous: Tensor, farthest: float = 0.25) -> tuple[int, int]:
    """(x, y) whole pixels by which current(p) looks most like previous(p + shift) in most of the image.

    Images (1, C, H, W), finite; channels are averaged. The highest peak of the phase correlation, with a Hann window
    against the border, may be that of a small bright thing that moves by itself, so the median difference of the
    overlap decides among the highest. No shift wins ties. farthest: longest shift along an axis, in image sizes: what
    overlaps less says less. Costs three Fourier transforms.
    """
    height, width = current.shape[-2:]
    current, previous = current.mean(1, keepdim=True), previous.mean(1, keepdim=True)
    best, least = (0, 0), _difference(current, previous, 0, 0)
    for x, y in _peaks(current, previous):
        if abs(x) <= width * farthest and abs(y) <= height * farthest:
            found = _difference(current, previous, x, y)
            if found < _BETTER * least:
                best, least = (x, y), found
    return best


def _peaks(current: Tensor, previous: Tensor) -> list[tuple[int, int]]:
    """The shifts (x, y) of the highest local maxima of the phase correlation, highest first."""
    height, width = current.shape[-2:]
    rows, columns = (torch.hann_window(size, False).to(current) for size in (height, width))
    window = rows[:, None] * columns
    spectra = [torch.fft.rfft2((image - image.mean()) * window) for image in (current, previous)]
    cross = spectra[0].conj() * spectra[1]
    surface = torch.fft.irfft2(cross / cross.abs().sqrt().clamp(min=1e-20), s=(height, width))
    surface = torch.where(surface == F.max_pool2d(surface, 3, 1, 1), surface, -torch.inf).flatten()
    places = surface.topk(min(_PEAKS, surface.numel())).indices.tolist()
    half_x, half_y = width // 2, height // 2
    return [((p % width + half_x) % width - half_x, (p // width + half_y) % height - half_y) for p in places]


def _difference(current: Tensor, previous: Tensor, x: int, y: int) -> float:
    """Median |current(p) − previous(p + (x, y))| where both are there, but for what a fraction of a pixel explains.

    Means of 3×3 pixels, against noise. The fraction is that of least squares (Lucas and Kanade 1981): without it a
    pattern that repeats would fit better a period away than half a pixel off.
    """
    height, width = current.shape[-2:]
    now = current[..., max(-y, 0) : height - max(y, 0), max(-x, 0) : width - max(x, 0)]
    then = previous[..., max(y, 0) : height - max(-y, 0), max(x, 0) : width - max(-x, 0)]
    size = min(3, now.shape[-2]), min(3, now.shape[-1])
    apart, both = F.avg_pool2d(now - then, size)[0, 0], F.avg_pool2d(now + then, size)[0, 0] / 2
    if min(apart.shape) >= 3:
        slopes = torch.stack([both[1:-1, 2:] - both[1:-1, :-2], both[2:, 1:-1] - both[:-2, 1:-1]]).flatten(1) / 2
        apart = apart[1:-1, 1:-1].flatten()
        normal = slopes @ slopes.T
        if normal.isfinite().all():
            fraction = torch.linalg.pinv(normal, hermitian=True) @ (slopes @ apart)
            apart = apart - fraction.clamp(-_FRACTION, _FRACTION) @ slopes
    return float(apart.abs().median())
