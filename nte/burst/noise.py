"""The noise of a sensor as a function of the signal: σ²(x) = a·x + b, fitted to the burst itself.

Source of the model: Foi et al. 2008, «Practical Poissonian-Gaussian noise modeling and fitting for single-image
raw-data». The fit is nte's own.
"""

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor

from nte.burst.mosaic import Mosaic
from nte.errors import NteError

_TILE = 4  # quads along each axis of a tile, over which variance is estimated
_BINS = 16  # bins of the signal, with equally many tiles in each
_SHARE = 0.25  # share of a bin's tiles that count as flat in the first round
_ACCEPTED = 1.4  # later, tiles below this multiple of the fitted variance are flat: nearly all that really are
_ROUNDS = 4  # rounds of fitting
_CHANGED = 10.0  # times what nine tenths of similar signals vary at most: not noise, but a thing in one frame alone
_LEAST = 64  # least number of flat tiles for a fit
_SATURATED = 0.95  # share of the white level above which noise is cut off
_FLOOR = 1e-10  # least variance; rounding to 16 bits has about this much


@dataclass(frozen=True)
class NoiseModel:
    """A model of noise, σ²(x) = a·x + b, for signals x in [0, 1] of the white level; a: photons, b: electronics.

    Raises NteError if a or b is negative or not finite, or if both are 0.
    """

    a: float
    b: float

    def __post_init__(self) -> None:
        if not (0 <= self.a < float("inf") and 0 <= self.b < float("inf") and self.a + self.b > 0):
            raise NteError(f"noise model a = {self.a}, b = {self.b}: expected two numbers of at least 0, not both 0")

    def scaled(self, factor: float) -> "NoiseModel":
        """Return the model of the noise in signals that are multiplied by a factor above 0."""
        return NoiseModel(self.a * factor, self.b * factor * factor)

    def variance(self, signal: Tensor) -> Tensor:
        """Compute the variance σ² of signals of any shape; negative signals count as 0."""
        return (self.a * signal.clamp(min=0) + self.b).clamp(min=_FLOOR)


def fit_noise(first: Tensor, second: Tensor, mosaic: Mosaic | None, clips: bool = True) -> NoiseModel:
    """Fit the model to two frames of a burst, mosaics (1, 1, H, W) or images (1, C, H, W); they need not be aligned.

    clips: true if values end at 1, so that noise is cut off near there.

    Four neighbouring pixels of one colour (p q / r s) give (p − q − r + s)/2, which has the noise's variance and no
    trace of a linear gradient. One frame selects the flat tiles, and the other measures the variance there: a tile
    that is selected because it looks quiet would otherwise count as less noisy than it is. The first round takes the
    quietest tiles, later ones all tiles that are as quiet as the fit says. If no part of the picture is flat, texture
    counts as noise. Raises NteError if fewer than 64 flat tiles are not saturated.
    """
    tiles = _tiles(first, mosaic), _tiles(second, mosaic)
    both = (tiles[0], tiles[1]), (tiles[1], tiles[0])
    most = _SATURATED if clips else float("inf")
    usable = [(select[:, 2] < most) & (measure[:, 2] < most) for select, measure in both]
    flat = [_quietest(select) & use for (select, _), use in zip(both, usable, strict=True)]
    for _ in range(_ROUNDS):
        found = torch.cat([measure[part] for (_, measure), part in zip(both, flat, strict=True)]).double()
        found = found[_unchanged(found)]
        if len(found) < _LEAST:
            raise NteError(
                f"the noise cannot be fitted: {len(found)} flat tiles that are not saturated, {_LEAST} are needed: "
                "give --noise"
            )
        model = NoiseModel(*_line(found[:, 0], found[:, 1]))
        flat = [
            (select[:, 1] < model.variance(select[:, 0]) * _ACCEPTED) & use
            for (select, _), use in zip(both, usable, strict=True)
        ]
    return model


def _quietest(tiles: Tensor) -> Tensor:
    """Bool mask (T,): the quarter with the least variance among tiles of similar signal."""
    flat = torch.zeros(len(tiles), dtype=torch.bool, device=tiles.device)
    for part in tiles[:, 0].argsort().chunk(_BINS):
        flat[part[tiles[part, 1].argsort()[: int(len(part) * _SHARE)]]] = True
    return flat


def _unchanged(tiles: Tensor) -> Tensor:
    """Bool mask (T,): the tiles whose variance could be that of their signal's noise.

    A tile that is flat in the frame that selects it may have a bright speck in the one that measures it.
    """
    kept = torch.zeros(len(tiles), dtype=torch.bool, device=tiles.device)
    for part in tiles[:, 0].argsort().chunk(_BINS):
        if len(part):
            kept[part] = tiles[part, 1] <= _CHANGED * tiles[part, 1].quantile(0.9, interpolation="lower")
    return kept


def _line(x: Tensor, v: Tensor) -> tuple[float, float]:
    """Fit v = a·x + b, a, b ≥ 0, by least squares, weighted since the spread of a variance is proportional to it."""
    fitted = v.mean().expand_as(v)
    a, b = 0.0, float(v.mean())
    for _ in range(5):
        weight = 1 / fitted.clamp(min=_FLOOR).square()
        total, mean_x, mean_v = weight.sum(), (weight * x).sum() / weight.sum(), (weight * v).sum() / weight.sum()
        spread = (weight * (x - mean_x).square()).sum()
        a = float((weight * (x - mean_x) * (v - mean_v)).sum() / spread) if spread > 1e-12 * total else 0.0
        b = float(mean_v) - a * float(mean_x)
        if b < 0:
            a, b = float((weight * x * v).sum() / (weight * x * x).sum()), 0.0
        if a < 0:
            a, b = 0.0, float(mean_v)
        fitted = a * x.clamp(min=0) + b
    return a, max(b, _FLOOR)


def _tiles(image: Tensor, mosaic: Mosaic | None) -> Tensor:
    """Mean, variance and brightest pixel of each tile, (T, 3); texture counts in the variance."""
    found = []
    for p, q, r, s in _quads(image, mosaic):
        if min(p.shape[-2:]) < _TILE:
            continue
        four = torch.stack([p, q, r, s], 1)
        mean = F.avg_pool2d(four.mean(1, keepdim=True), _TILE)
        variance = F.avg_pool2d(((p - q - r + s) / 2).square()[:, None], _TILE)
        brightest = F.max_pool2d(four.amax(1, keepdim=True), _TILE)
        found.append(torch.cat([mean, variance, brightest], 1).permute(0, 2, 3, 1).reshape(-1, 3))
    return torch.cat(found) if found else image.new_zeros(0, 3)


def _quads(image: Tensor, mosaic: Mosaic | None) -> list[tuple[Tensor, Tensor, Tensor, Tensor]]:
    """Quads of 2×2 neighbours of one colour, each pixel's plane (1, h, w); no pixel is in two quads."""
    if mosaic is None:
        planes = [image[:, c] for c in range(image.shape[1])]
    elif mosaic.period == 2:
        planes = [image[:, 0, y::2, x::2] for y in range(2) for x in range(2)]
    else:  # X-Trans has one square of green on every corner of its blocks
        y, x = ((start - 1) % mosaic.block for start in mosaic.origin)
        corner = image[:, 0, y:, x:]
        planes = [_first_two(_first_two(corner, 1), 2)]
    even = [plane[:, : plane.shape[1] // 2 * 2, : plane.shape[2] // 2 * 2] for plane in planes]
    return [(p[:, ::2, ::2], p[:, ::2, 1::2], p[:, 1::2, ::2], p[:, 1::2, 1::2]) for p in even]


def _first_two(plane: Tensor, axis: int) -> Tensor:
    """The first two of every three rows (axis 1) or columns (axis 2)."""
    index = torch.arange(plane.shape[axis] // 3 * 3, device=plane.device)
    return plane.index_select(axis, index[index % 3 < 2])
