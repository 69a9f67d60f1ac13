"""The shift of a whole image, proposed by phase correlation and decided by most of the image.

Kuglin and Hines 1975, «The Phase Correlation Image Alignment Method».
"""

from itertools import product

import torch
import torch.nn.functional as F
from torch import Tensor

from nte.motion.pyramid import smaller

_PEAKS = 16  # highest peaks of the phase correlation that are tried
_FRACTION = 1 / 3  # a pixel, in units of the means' spacing
# A shift must have less than _BETTER − _CHANCE/√n of the best ratio so far, where n means are compared: fitting as well
# is not enough, and the median of few ratios is small by chance for one of so many shifts.
_BETTER, _CHANCE = 0.9, 3.0
_LEAST = 0.1  # share of the means that must count
_ROUNDING = 1e-5  # of the largest value: a smaller difference is none
_MEAN = 3  # px: side of the squares whose means are compared, against noise
_SMALLEST = 3 * _MEAN  # px: the least overlap
# Shifts around one that is known to a pixel of twice the size, the shortest first, since the first wins ties.
_AROUND = sorted(product(range(-2, 3), repeat=2), key=lambda shift: shift[0] ** 2 + shift[1] ** 2)


def whole_shift(current: Tensor, previous: Tensor, farthest: float = 0.25) -> tuple[int, int]:
    """Find the whole-pixel shift (x, y) for which current(p) looks most like previous(p + shift) in most of the image.

    Areas that fit as well without the shift do not count, such as a background without noise. current and previous
    (1, C, H, W): finite; channels are averaged. farthest: longest shift along an axis, as a share of the image size; a
    small overlap proves little. The phase correlation uses a Hann window against the border. Its highest peak may
    belong to a small bright object that moves by itself, so the whole overlap decides among the highest peaks. No shift
    wins ties. Costs three Fourier transforms.
    """
    height, width = current.shape[-2:]
    current, previous = current.mean(1, keepdim=True), previous.mean(1, keepdim=True)
    best, least = (0, 0), 1.0
    if min(height, width) < _SMALLEST:
        return best
    unshifted = _difference(current, previous)
    for x, y in _peaks(current, previous):
        if abs(x) <= width * farthest and abs(y) <= height * farthest:
            found, count = _ratio(current, previous, unshifted, x, y)
            if found < (_BETTER - _CHANCE / count**0.5) * least:
                best, least = (x, y), found
    return best


def nearest_shift(current: Tensor, previous: Tensor, x: int, y: int, step: int) -> tuple[int, int]:
    """Find the whole-pixel shift near (x, y), px, with the least mean |current(p) − previous(p + shift)|.

    current and previous (1, C, H, W): finite. step: px, a power of two; x and y are multiples of it, and known to it.
    The overlap must be longer than twice as much along each axis.
    """
    while step > 1:
        step //= 2
        now, then = smaller(current, step), smaller(previous, step)
        near = [(x + step * right, y + step * down) for right, down in _AROUND]
        x, y = min(near, key=lambda shift: mean_difference(now, then, shift[0] // step, shift[1] // step))
    return x, y


def nearest_of(current: Tensor, previous: Tensor, x: int, y: int) -> tuple[tuple[int, int], float]:
    """Find which of (x, y) and its eight neighbours has the least `mean_difference`, and return both."""
    near = [(x + right, y + down) for right, down in _AROUND if max(abs(right), abs(down)) < 2]
    differences = [mean_difference(current, previous, *shift) for shift in near]
    least = min(range(len(near)), key=differences.__getitem__)
    return near[least], differences[least]


def mean_difference(current: Tensor, previous: Tensor, x: int, y: int) -> float:
    """Compute the mean |current(p) − previous(p + shift)| of the overlap of two images (1, C, H, W); x and y in px."""
    height, width = current.shape[-2:]
    now = current[..., max(-y, 0) : height - max(y, 0), max(-x, 0) : width - max(x, 0)]
    then = previous[..., max(y, 0) : height + min(y, 0), max(x, 0) : width + min(x, 0)]
    return float((now - then).abs_().mean())


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


def _ratio(current: Tensor, previous: Tensor, unshifted: Tensor, x: int, y: int) -> tuple[float, int]:
    """The median ratio of the differences with the shift to those without it, and the number of ratios.

    A ratio per place, not one of two medians: where a background without noise fills about half of the image, a little
    more or less of it in the overlap would change a median of differences from that of noise to nothing. If hardly
    anything counts, the ratio is 1.
    """
    height, width = current.shape[-2:]
    top, left = (-(-max(-shift, 0) // _MEAN) for shift in (y, x))  # in means, which are those of `unshifted`
    rows, columns = slice(top * _MEAN, height - max(y, 0)), slice(left * _MEAN, width - max(x, 0))
    now = current[..., rows, columns]
    if min(now.shape[-2:]) < _SMALLEST:
        return 1.0, 1
    then = previous[..., rows.start + y : rows.stop + y, columns.start + x : columns.stop + x]
    shifted = _difference(now, then)
    unshifted = unshifted[top : top + shifted.shape[0], left : left + shifted.shape[1]]
    counts = torch.maximum(shifted, unshifted) > _ROUNDING * now.abs().max()
    ratio = (shifted / unshifted)[counts]
    return (float(ratio.median()), ratio.numel()) if ratio.numel() >= _LEAST * counts.numel() else (1.0, 1)


def _difference(now: Tensor, then: Tensor) -> Tensor:
    """The differences |now − then| of 3×3 pixels' means, but the outermost, beyond what a fraction of a pixel explains.

    The fraction is found by least squares (Lucas and Kanade 1981); without it, a repeating pattern would fit better a
    whole period away than half a pixel off.
    """
    both = torch.cat([now, then])
    means = F.avg_pool2d(both, _MEAN)[:, 0]
    extent = (F.max_pool2d(both, _MEAN) + F.max_pool2d(-both, _MEAN))[:, 0, 1:-1, 1:-1]
    varies = extent > _ROUNDING * means.abs().max()
    apart, mean = (means[0] - means[1])[1:-1, 1:-1], means.mean(0)
    slopes = torch.stack([mean[1:-1, 2:] - mean[1:-1, :-2], mean[2:, 1:-1] - mean[:-2, 1:-1]]) / 2
    normal = (slopes[:, None] * slopes).sum((2, 3))
    if normal.isfinite().all():
        fraction = (torch.linalg.pinv(normal, hermitian=True) * (slopes * apart).sum((1, 2))).sum(1)
        rest = apart - (fraction.clamp(-_FRACTION, _FRACTION).view(2, 1, 1) * slopes).sum(0)
        # Noise falsifies the fraction, which would then make areas differ that are equal.
        apart = torch.where(rest.abs() < apart.abs(), rest, apart)
    # Noise differs less from what has none than from other noise.
    return apart.abs() * torch.where(varies[0] == varies[1], 1.0, 2**0.5)
