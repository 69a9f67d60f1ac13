"""The shift of a whole image, proposed by phase correlation and decided by the median difference.

Kuglin and Hines 1975, «The Phase Correlation Image Alignment Method».
"""

import torch
import torch.nn.functional as F
from torch import Tensor

_PEAKS = 16  # highest peaks of the phase correlation that are tried
_FRACTION = 1 / 3  # a pixel, in units of the means' spacing
# A shift must have less than _BETTER − _CHANCE/√n of the best difference so far, where n means are compared: fitting as
# well is not enough, and the median of few means is small by chance for one of so many shifts.
_BETTER, _CHANCE = 0.9, 3.0
_LEAST = 0.1  # share of the means that must count
_ROUNDING = 1e-5  # of the largest value: a smaller difference is none


def whole_shift(current: Tensor, previous: Tensor, farthest: float = 0.25) -> tuple[int, int]:
    """Find the whole-pixel shift (x, y) for which current(p) looks most like previous(p + shift) in most of the image.

    Areas that are constant, such as a background without noise, do not count. current and previous (1, C, H, W):
    finite; channels are averaged. farthest: longest shift along an axis, as a share of the image size; a small overlap
    proves little. The phase correlation uses a Hann window against the border. Its highest peak may belong to a small
    bright object that moves by itself, so the median difference of the overlap decides among the highest peaks. No
    shift wins ties. Costs three Fourier transforms.
    """
    height, width = current.shape[-2:]
    current, previous = current.mean(1, keepdim=True), previous.mean(1, keepdim=True)
    best, (least, _) = (0, 0), _difference(current, previous, 0, 0)
    for x, y in _peaks(current, previous):
        if abs(x) <= width * farthest and abs(y) <= height * farthest:
            found, count = _difference(current, previous, x, y)
            if found < (_BETTER - _CHANCE / count**0.5) * least:
                best, least = (x, y), found
    return best


def _peaks(current: Tensor, previous: Tensor) -> list[tuple[int, int]]:
    """The shifts (x, y) at the highest local maxima of the phase correlation, highest first."""
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


def _difference(current: Tensor, previous: Tensor, x: int, y: int) -> tuple[float, int]:
    """The median of |current(p) − previous(p + (x, y))| over the overlap, without what a fraction of a pixel explains.

    Returned with the number of values of which it is the median. Means of 3×3 pixels are compared, against noise. Where
    both images are constant and equal, such as in a background without noise, every shift fits, and nothing counts; if
    hardly anything does, the difference is 0. The fraction is found by least squares (Lucas and Kanade 1981); without
    it, a repeating pattern would fit better a whole period away than half a pixel off.
    """
    height, width = current.shape[-2:]
    now = current[..., max(-y, 0) : height - max(y, 0), max(-x, 0) : width - max(x, 0)]
    then = previous[..., max(y, 0) : height - max(-y, 0), max(x, 0) : width - max(-x, 0)]
    size = min(3, now.shape[-2]), min(3, now.shape[-1])
    both = torch.cat([now, then])
    means = F.avg_pool2d(both, size)[:, 0]
    rounding = _ROUNDING * means.abs().max()
    varies = (F.max_pool2d(both, size) + F.max_pool2d(-both, size))[:, 0] > rounding
    apart = means[0] - means[1]
    if min(apart.shape) >= 3:
        varies, apart = varies[:, 1:-1, 1:-1], apart[1:-1, 1:-1]
        mean = means.mean(0)
        slopes = torch.stack([mean[1:-1, 2:] - mean[1:-1, :-2], mean[2:, 1:-1] - mean[:-2, 1:-1]]) / 2
        normal = (slopes[:, None] * slopes).sum((2, 3))
        if normal.isfinite().all():
            fraction = (torch.linalg.pinv(normal, hermitian=True) * (slopes * apart).sum((1, 2))).sum(1)
            apart = apart - (fraction.clamp(-_FRACTION, _FRACTION).view(2, 1, 1) * slopes).sum(0)
    # Noise differs less from what has none than from other noise.
    apart = apart.abs() * torch.where(varies[0] == varies[1], 1.0, 2**0.5)
    found = apart[varies.any(0) | (apart > rounding)]
    return (float(found.median()), found.numel()) if found.numel() >= _LEAST * apart.numel() else (0.0, 1)
