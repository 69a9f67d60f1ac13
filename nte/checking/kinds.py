"""Functions of position that a depth may be: linear, as along the view axis, or another one that producers write.

Each is fitted to points and their depth. Its error is told in shares of the depths' spread: the right function explains
half of the points up to rounding. Others may come close to it; then the closest one is right.
"""

from typing import NamedTuple

import torch
from torch import Tensor

EXACT = 2e-3  # a function fits if half of the points miss it by less than this share of the depths' spread
FLAT = 0.02  # points whose least extent is a smaller share of the greatest lie in a plane, and tell no scale
CENTRED = 0.1  # squared distances from a point are 0 there, up to this share of the median of the squared depths
THIN = 1e-10  # least share of the greatest singular value of sums of squares; less is rounding, as across a plane
OUTLIER = 1e-6  # of the median depth: what misses a function by less is rounding, though all others fit exactly
COARSE = 3.0  # least extent of the points, in steps of their rounding, that tells a scale
RATES, STEP = 36, 1.26  # exponentials that are tried, from 0.01 on, and the ratio of their rates
CLOSER = 7  # times that this ratio is narrowed around the best of them

KINDS = {  # field of Fit → what such a depth is; of those that explain it about as well the first one is named
    "distance": "the distance from the camera",
    "buffer": "inverse or a z-buffer",
    "logarithm": "a logarithm",
    "root": "a square root",
}


class Fit(NamedTuple):
    """How well each function of position explains a frame's depth (errors as shares of its spread), and its scale."""

    axis: float
    distance: float
    buffer: float
    logarithm: float
    root: float
    scale: float | None  # depth per unit of position along the axis; None if unknown
    behind: float  # share of the points in the half of all directions that is opposite to the others


def explain(points: Tensor, depth: Tensor, steps: Tensor | None = None) -> tuple[Fit, Tensor | None]:
    """Fit functions of points (3, n) to their depth (n,).

    steps: (n,), to which points are rounded; errors up to half of them are none. Also returns the view axis (3,), which
    is the gradient of depth; None if all points lie in a plane.
    """
    centre = points.mean(1, keepdim=True)
    size = _extent(points)[-1].clamp(min=1e-30)
    near = ((points - centre) / size).T
    linear = torch.cat([near, torch.ones_like(near[:, :1])], 1)
    unit = depth / depth.median()
    rounded = 0.0 if steps is None else steps / depth.median() / 2
    spread = (unit - unit.median()).abs().median().clamp(min=1e-3)

    def error(values: Tensor) -> float:
        off = (values - unit).abs().nan_to_num(1e30, 1e30, 1e30)
        return float((off - rounded).clamp(min=0).median() / spread)

    # Fitted again without outliers: silhouettes show means of several surfaces.
    plane = _solve(linear, unit)
    off = (linear @ plane - unit).abs()
    kept = off <= 3 * off.median() + OUTLIER + rounded
    plane = _solve(linear[kept], unit[kept])
    along = error(linear @ plane)
    to_camera, behind = _distance(near, linear, unit)
    # z = A + B/(a·P + b) is a quotient of two linear functions: z (a·P + b) − (c·P + d) = 0.
    quotient = torch.linalg.eigh(_gram(torch.cat([linear * unit[:, None], -linear], 1)))[1][:, 0]
    buffer = error((linear @ quotient[4:]) / (linear @ quotient[:4]))
    logarithm = root = float("inf")
    if along > EXACT:
        scaled = (unit - unit.median()) / spread
        logarithm = _logarithm(linear, scaled)
        root = error((linear @ _solve(linear, unit.square())).clamp(min=0).sqrt())
    axis, extent = plane[:3] * depth.median() / size, _extent(points[:, kept])
    known = float(extent[0]) > max(FLAT * float(size), 0.0 if steps is None else COARSE * float(steps.median()))
    errors = along, error(to_camera), buffer, logarithm, root
    return Fit(*errors, float(axis.norm()) if known else None, behind), axis if known else None


def _extent(points: Tensor) -> Tensor:
    """Standard deviations (3,) of points (3, n) along their principal axes, the least first."""
    extent: Tensor = torch.linalg.eigvalsh(torch.cov(points)).clamp(min=0).sqrt()
    return extent


def _distance(near: Tensor, linear: Tensor, unit: Tensor) -> tuple[Tensor, float]:
    """Fit the distance from a point; NaN if no point has the distance 0. Also the share of points behind that point."""
    rows = torch.cat([linear, near.square().sum(1, keepdim=True)], 1)
    sphere = _solve(rows, unit.square())
    rays = near + sphere[:3] / (2 * sphere[4]).clamp(min=1e-30)  # from the camera, if depth is the distance from it
    rays = rays / rays.norm(dim=1, keepdim=True).clamp(min=1e-30)
    behind = float((rays @ rays.mean(0) < 0).double().mean())
    # Any square of a linear function would do: that of a square root has hardly a quadratic part.
    offset = sphere[3] - sphere[:3].square().sum() / (4 * sphere[4]).clamp(min=1e-30)
    values = (rows @ sphere).clamp(min=0).sqrt()
    return values if float(offset.abs()) <= CENTRED else torch.full_like(values, torch.nan), behind


def _logarithm(linear: Tensor, scaled: Tensor) -> float:
    """Fit a logarithm of any base to depths (n,), scaled by their spread, and return its error."""

    def error(rate: float) -> float:
        power = (rate * scaled).exp()
        found = (linear @ _solve(linear, power)).log() / rate
        return float((found - scaled).abs().nan_to_num(1e30, 1e30, 1e30).median())

    best, step = min((0.01 * STEP**i for i in range(RATES)), key=error), STEP
    for _ in range(CLOSER):
        step = step ** (1 / 2)
        best = min((best / step, best, best * step), key=error)
    return error(best)


def _solve(rows: Tensor, values: Tensor) -> Tensor:
    """Least squares of rows (n, k) to values (n,), by the normal equations: the rows are centred and of unit size."""
    solved: Tensor = torch.linalg.pinv(_gram(rows), rtol=THIN, hermitian=True) @ (rows.T @ values)
    return solved


def _gram(rows: Tensor) -> Tensor:
    return rows.T @ rows
