"""A check that the reference has the colours of `color`: the same components, in one order, of one colour space.

Blocks of pixels are compared by what share of their light each component has, in which noise is small: a path that
finds much light finds it in all of them. If the shares differ, and one matrix takes those of the reference to those of
the colour, it is that matrix that differs. The matrix is fitted to every other block and judged by the rest, so noise
is explained by none. A tone curve changes colours as well, but not in proportion to the light.
"""

from collections.abc import Iterator
from itertools import permutations

import torch
import torch.nn.functional as F
from torch import Tensor

from nte.checking.values import Finding

ENOUGH = 24  # least number of blocks that tell
APART = 0.03  # least median distance between the shares that is told; measured: 0.0004 to 0.019 in right clips
LEFT = 0.3  # a matrix explains them if it leaves at most this share; measured: 0.9 to 3 in right clips, 0.01 to 0.13
GREY = 0.01  # greatest median distance from grey of a picture without colours
IN_PROPORTION = 0.15  # greatest difference of the power of the light from 1, which curves have
EXPECTED = "the colour space, white balance and order of components of color"


class ColourTally:
    """Sums over a clip, by block and component: of every other pixel of colour, of the rest, and of the reference."""

    def __init__(self) -> None:
        self._sums: Tensor | None = None

    def add(self, color: Tensor, reference: Tensor, blocks: tuple[int, int]) -> None:
        """Add the light (3, H, W) of a frame, as means of so many blocks (h, w)."""
        odd = torch.arange(color.shape[1]).unsqueeze(1) + torch.arange(color.shape[2])
        images = torch.stack([color * (odd % 2), color * (1 - odd % 2), reference])
        means = F.adaptive_avg_pool2d(images, blocks).double().flatten(2)
        self._sums = means if self._sums is None else self._sums + means

    def judge(self) -> Iterator[Finding]:
        """Yield a fault for a reference whose colours are others, in proportion to the light, or that is grey."""
        if self._sums is None:
            return
        means = self._sums.mean(1)
        lit = (means[:2] > 0).all(0) & (means[2] > 0.01 * means[2].mean())
        first, second, reference = self._sums[..., lit]
        color = first + second
        if color.shape[1] < ENOUGH:
            return
        apart = _apart(color, reference)
        if apart <= APART:
            return
        even, odd = (slice(i, None, 2) for i in (0, 1))
        tested = [(_matrix(reference[:, a], color[:, a]) @ reference[:, b]) for a, b in ((even, odd), (odd, even))]
        matched = torch.cat(tested, 1).clamp(min=1e-30)
        given = torch.cat([color[:, odd], color[:, even]], 1)
        if _apart(reference, torch.ones_like(reference)) < GREY:
            if _apart(first, second) < apart:  # else what colour there is is noise
                yield Finding("reference", "is grey, and color is not", EXPECTED)
        elif _apart(given, matched) < LEFT * apart and abs(_power(matched, given) - 1) < IN_PROPORTION:
            yield Finding("reference", f"has other colours than color: {_what_differs(color, reference)}", EXPECTED)


def _shares(light: Tensor) -> Tensor:
    return light / light.mean(0)


def _apart(one: Tensor, other: Tensor) -> float:
    return float((_shares(one) - _shares(other)).norm(dim=0).median())


def _matrix(given: Tensor, wanted: Tensor) -> Tensor:
    """Fit the matrix (3, 3) that takes the shares of `given` (3, n) to those of `wanted`."""
    solved: Tensor = torch.linalg.lstsq(_shares(given).T, _shares(wanted).T, driver="gelsd").solution.T
    return solved


def _power(given: Tensor, wanted: Tensor) -> float:
    """Fit the power of the brightness of `given` (3, n) that is in proportion to that of `wanted`."""
    x, y = (light.mean(0).log() - light.mean(0).log().mean() for light in (given, wanted))
    return float((x * y).sum() / x.square().sum().clamp(min=1e-30))


def _what_differs(color: Tensor, reference: Tensor) -> str:
    apart = _apart(color, reference)
    order = min(permutations(range(3)), key=lambda order: _apart(color, reference[list(order)]))
    if order != (0, 1, 2) and _apart(color, reference[list(order)]) < LEFT * apart:
        return f"its components are in the order {''.join('RGB'[order.index(i)] for i in range(3))}"
    factors = (color / reference).median(1).values
    times = ", ".join(f"{name} {factor:.3g}" for name, factor in zip("RGB", factors.tolist(), strict=True))
    return f"another white balance or colour space; color is so many times as bright: {times}"
