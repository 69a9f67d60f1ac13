"""A check that depth, position, normals and camera of one frame belong together: they show the same surfaces.

The depth of a point along the view axis is a linear function of its position, whatever the camera. Distances from the
camera and z-buffers are other functions of it; a panorama, which sees points in all directions, has nothing but the
distance. A camera sees every position in its own pixel. Where there is a camera and no position, position is made from
depth. Normals are compared with positions in `nte.checking.normals`.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from statistics import median
from typing import NamedTuple, cast

import torch
from torch import Tensor

from nte.checking.normals import Turn, judge_turns, turn_of
from nte.checking.values import MANY, Finding
from nte.frames.frame import Frame
from nte.motion.camera import points_from_depth, project
from nte.motion.warp import pixel_centres

ENOUGH = 200  # least number of surface points that can tell
SAMPLED = 4096  # points of a frame that are looked at, up to twice as many
EXACT = 2e-3  # a function fits if half of the points miss it by less than this share of the depths' spread
FITS_NOT = 0.1  # no function fits: half of the points miss each of them by more than this share
SAME_SCALE = 1.05  # greatest ratio of the units of depth and position
FLAT = 0.02  # points whose least extent is a smaller share of the greatest lie in a plane, and tell no scale
PANORAMA = 0.1  # a greater share of the points behind: no camera with a view axis sees them all
BESIDE = 2.0  # px: greatest distance at which a camera sees half of the surfaces beside their own pixels
FAR = 100.0  # a depth that many pixels share exactly, this many times the median of the others, is no surface


class _Fit(NamedTuple):
    """How well each function of position explains a frame's depth (errors as shares of its spread), and its scale."""

    axis: float
    distance: float
    buffer: float
    scale: float | None  # depth per unit of position along the axis; None if unknown
    behind: float  # share of the points in the half of all directions that is opposite to the others


@dataclass
class GeometryTally:
    """Tally of what depth, position and normals of a clip's frames say about each other."""

    _fits: list[_Fit] = field(default_factory=list)
    _turns: list[Turn] = field(default_factory=list)
    _beside: list[float] = field(default_factory=list)  # px: how far from its pixel the camera sees a frame's surface
    _pixels: int = 0
    _alone: int = 0  # pixels that have a depth, but no normal (without normals: no instance)
    _alone_low: float = float("inf")
    _alone_high: float = 0.0
    _others_high: float = 0.0
    _high: float = 0.0
    _constant: int = 0  # pixels that share one large depth exactly
    _shown_by: str = "position"  # what tells where surfaces are
    _blank: str = ""  # the channel that shows no surface there

    def add(self, frame: Frame) -> None:
        """Add a PyTorch frame of batch 1; those without depth and position tell nothing."""
        if not ("depth" in frame or "position" in frame):
            return
        depth = frame["depth"][0, 0].double().nan_to_num(0, 0, 0) if "depth" in frame else None
        if depth is not None:
            self._add_misses(frame, depth)
        position = _positions(frame)
        if position is None:
            return
        self._shown_by = "position" if "position" in frame else "depth and cameras"
        hit = position.isfinite().all(0) & (position != 0).any(0)
        hit = hit if depth is None else hit & (depth > 0)
        if int(hit.sum()) < ENOUGH:
            return
        if "position" in frame and frame.view is not None and frame.projection is not None:
            seen = project(position[None], frame.view.double(), frame.projection.double())
            apart = (seen - pixel_centres(seen))[0, :, hit].norm(dim=0).nan_to_num(float("inf"))
            self._beside.append(float(apart.median()))
        axis, fits = None, True
        if depth is not None:
            step = max(1, int(hit.sum()) // SAMPLED)
            fit, axis = _explain(position[:, hit][:, ::step], depth[hit][::step])
            self._fits.append(fit)
            fits = fit.axis < FITS_NOT
        if "normal" in frame and fits and (turn := turn_of(frame["normal"][0].double(), position, hit, depth, axis)):
            self._turns.append(turn)

    def _add_misses(self, frame: Frame, depth: Tensor) -> None:
        self._pixels += depth.numel()
        self._blank = next((name for name in ("normal", "instance") if name in frame), "")
        hits = depth[depth > 0]
        if self._blank:
            alone = (depth > 0) & (frame[self._blank][0] == 0).all(0)
            self._alone += int(alone.sum())
            if alone.any():
                self._alone_low = min(self._alone_low, float(depth[alone].min()))
                self._alone_high = max(self._alone_high, float(depth[alone].max()))
            if (others := depth[(depth > 0) & ~alone]).numel():
                self._others_high = max(self._others_high, float(others.max()))
        if hits.numel():
            self._high = max(self._high, float(hits.max()))
            same = hits == hits.max()
            if not same.all() and float(hits.max()) >= FAR * float(hits[~same].median()):
                self._constant += int(same.sum())

    def judge(self) -> Iterator[Finding]:
        """Yield findings about depths of misses, depths of another kind, and normals of another space."""
        yield from self._judge_misses()
        if self._fits:
            yield from self._judge_depth()
        yield from judge_turns(self._turns, self._shown_by)
        if self._beside and (beside := median(self._beside)) > BESIDE:
            where = f"{beside:.3g} px beside them" if beside < float("inf") else "behind the camera"
            expected = "of each frame: view from world space, projection to [0, 1]² with y down; or no cameras"
            yield Finding("cameras", f"do not see position in its own pixels, but {where}", expected)

    def _judge_misses(self) -> Iterator[Finding]:
        expected = "0 for a miss (sky): nte import takes depths from depth.sky on for misses"
        if self._blank and self._alone > MANY * self._pixels:
            share = f"in {self._alone / self._pixels:.1%} of the pixels there is a depth and no {self._blank}"
            beyond = self._alone_low >= self._others_high > 0
            found = f"{share}: {self._alone_low:.4g} to {self._alone_high:.4g}"
            yield Finding("depth", f"{found}, beyond all surfaces" if beyond else found, expected, beyond)
        elif self._constant > MANY * self._pixels:
            share = f"{self._constant / self._pixels:.1%} of the pixels have exactly the greatest depth"
            found = f"{share}, {self._high:.4g}, over {FAR:.0f} times that of the others"
            yield Finding("depth", found, expected, False)

    def _judge_depth(self) -> Iterator[Finding]:
        axis = median(fit.axis for fit in self._fits)
        distance, buffer = median(fit.distance for fit in self._fits), median(fit.buffer for fit in self._fits)
        expected = "the distance along the view axis"
        if axis > EXACT and distance < min(axis / 10, EXACT):
            if median(fit.behind for fit in self._fits) > PANORAMA:
                return
            found = "is the distance from the camera, as position shows"
            yield Finding("depth", found, f"{expected} (on import depth.along=ray)")
        elif axis > EXACT and buffer < min(axis / 10, EXACT):
            yield Finding("depth", "is inverse or a z-buffer, as position shows", expected)
        elif axis > FITS_NOT:
            yield Finding("depth", "does not belong to position: no camera sees both", expected)
        elif scales := [fit.scale for fit in self._fits if fit.scale is not None]:
            scale = median(scales)
            if not 1 / SAME_SCALE < scale < SAME_SCALE:
                yield Finding("depth", f"is {scale:.4g} times as long as position shows", "the units of position")
            elif max(scales) > SAME_SCALE**2 * min(scales):
                found = f"is {min(scales):.4g} to {max(scales):.4g} times as long as position shows, as frames differ"
                yield Finding("depth", found, "the units of position in all frames", False)


def _positions(frame: Frame) -> Tensor | None:
    """World points (3, H, W) of the surfaces, from position, or else from depth and camera; None without both."""
    if "position" in frame:
        return cast(Tensor, frame["position"][0].double())
    if frame.view is None or frame.projection is None:
        return None
    return points_from_depth(frame["depth"].double(), frame.view.double(), frame.projection.double())[0]


def _explain(points: Tensor, depth: Tensor) -> tuple[_Fit, Tensor | None]:
    """Fit functions of points (3, n) to their depth (n,).

    Also returns the view axis (3,), which is the gradient of depth; None if all points lie in a plane.
    """
    centre = points.mean(1, keepdim=True)
    extent = torch.linalg.eigvalsh(torch.cov(points)).clamp(min=0).sqrt()
    size = extent[-1].clamp(min=1e-30)
    near = ((points - centre) / size).T
    ones = torch.ones_like(near[:, :1])
    linear = torch.cat([near, ones], 1)
    unit = depth / depth.median()
    spread = (unit - unit.median()).abs().median().clamp(min=1e-3)

    def error(values: Tensor) -> float:
        return float(((values - unit).abs().nan_to_num(1e30, 1e30, 1e30)).median() / spread)

    # Fitted again without outliers: silhouettes show means of several surfaces.
    plane = _solve(linear, unit)
    off = (linear @ plane - unit).abs()
    plane = _solve(*(values[off <= 3 * off.median() + 1e-9] for values in (linear, unit)))
    distance = torch.cat([linear, near.square().sum(1, keepdim=True)], 1)
    sphere = _solve(distance, unit.square())
    squared = distance @ sphere
    rays = near + sphere[:3] / (2 * sphere[4]).clamp(min=1e-30)  # from the camera, if depth is the distance from it
    rays = rays / rays.norm(dim=1, keepdim=True).clamp(min=1e-30)
    behind = float((rays @ rays.mean(0) < 0).double().mean())
    # z = A + B/(a·P + b) is a quotient of two linear functions: z (a·P + b) − (c·P + d) = 0.
    quotient = torch.linalg.eigh(_gram(torch.cat([linear * unit[:, None], -linear], 1)))[1][:, 0]
    buffer = (linear @ quotient[4:]) / (linear @ quotient[:4])
    axis = plane[:3] * depth.median() / size
    known = float(extent[0]) > FLAT * float(size)
    errors = error(linear @ plane), error(squared.clamp(min=0).sqrt()), error(buffer)
    return _Fit(*errors, float(axis.norm()) if known else None, behind), axis if known else None


def _solve(rows: Tensor, values: Tensor) -> Tensor:
    """Least squares of rows (n, k) to values (n,), by the normal equations: the rows are centred and of unit size."""
    solved: Tensor = torch.linalg.pinv(_gram(rows), hermitian=True) @ (rows.T @ values)
    return solved


def _gram(rows: Tensor) -> Tensor:
    return rows.T @ rows
