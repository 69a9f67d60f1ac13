"""Noise of a sensor as a function of the signal: σ²(x) = a·x + b, fitted from the burst itself.

The Gaussian–Poisson model of Foi et al. 2008, «Practical Poissonian-Gaussian noise modeling and fitting for
single-image raw-data»; the fit is ours.
"""

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor

from nte.burst.mosaic import Mosaic
from nte.errors import NteError

_TILE = 4  # quads along each axis over which variance is estimated
_BINS = 16  # of the signal, with equally many tiles in each
_SHARE = 0.25  # of the tiles of a bin that count as flat at first
_ACCEPTED = 1.4  # times the fitted variance: tiles below count as flat then, nearly all that are
_ROUNDS = 4
_LEAST = 64  # flat tiles below which there is nothing to fit
_SATURATED = 0.95  # of the white level: noise above is cut off
_FLOOR = 1e-10  # variance: rounding to 16 bits has about this much


@dataclass(frozen=True)
class NoiseModel:
    """σ²(x) = a·x + b for signals x in [0, 1] of the white level; a: photon noise, b: that of the electronics.

    Raises NteError where a or b is negative or both are 0.
    """

    a: float
    b: float

    def __post_init__(self) -> None:
        if not (0 <= self.a < float("inf") and 0 <= self.b < float("inf") and self.a + self.b > 0):
            raise NteError(f"noise model a = {self.a}, b = {self.b}: expected two numbers of at least 0, not both 0")

    def variance(self, signal: Tensor) -> Tensor:
        """σ² of signals of any shape; negative ones count as 0."""
        return (self.a * signal.clamp(min=0) + self.b).clamp(min=_FLOOR)


def fit_noise(first: Tensor, second: Tensor, mosaic: Mosaic | None) -> NoiseModel:
    """Fit the model to two frames of a burst, mosaics (1, 1, H, W) or images (1, C, H, W); they need not be aligned.

    Four neighbouring pixels of one colour (p q / r s) give (p − q − r + s)/2, which has the noise's variance and
    no trace of a linear gradient. One frame tells which tiles are flat, and the other what the variance is
    there: a tile that is chosen because it looks quiet would otherwise count as less noisy than it is. At first
    the quietest tiles are taken, then all that are as quiet as the fit says.
    Where no part of the picture is flat, texture counts as noise. Raises NteError where too little is usable.
    """
    tiles = _tiles(first, mosaic), _tiles(second, mosaic)
    both = (tiles[0], tiles[1]), (tiles[1], tiles[0])
    usable = [(select[:, 2] < _SATURATED) & (measure[:, 2] < _SATURATED) for select, measure in both]
    flat = [_quietest(select) & use for (select, _), use in zip(both, usable, strict=True)]
    for _ in range(_ROUNDS):
        found = torch.cat([measure[part] for (_, measure), part in zip(both, flat, strict=True)]).double()
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
    """(T,) bool: a quarter of the tiles of similar signal, those of least variance."""
    flat = torch.zeros(len(tiles), dtype=torch.bool, device=tiles.device)
    for part in tiles[:, 0].argsort().chunk(_BINS):
        flat[part[tiles[part, 1].argsort()[: int(len(part) * _SHARE)]]] = True
    return flat


def _line(x: Tensor, v: Tensor) -> tuple[float, float]:
    """a, b ≥ 0 of v = a·x + b by least squares; the spread of a variance is proportional to it, hence the weights."""
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
    """(T, 3): mean, variance of the noise (and of what is not flat) and brightest pixel of each tile."""
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
    """2×2 neighbours of one colour, each (1, h, w); no pixel is in two quads."""
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
    """Of every three rows (axis 1) or columns (axis 2) the first two."""
    index = torch.arange(plane.shape[axis] // 3 * 3, device=plane.device)
    return plane.index_select(axis, index[index % 3 < 2])
