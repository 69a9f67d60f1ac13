"""A check that depth, position, normals and camera of one frame belong together: they show the same surfaces.

The depth of a point along the view axis is a linear function of its position, whatever the camera. Distances from the
camera and z-buffers are other functions of it. A normal is perpendicular to the surface that neighbouring positions
span; if a single rotation of all normals makes it so, they are given in another space, such as that of the camera. A
camera sees every position in its own pixel. Where there is a camera and no position, position is made from depth.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from statistics import median
from typing import NamedTuple, cast

import torch
from torch import Tensor

from nte.checking.cells import ONE_SURFACE
from nte.checking.values import MANY, Finding
from nte.frames.frame import Frame
from nte.motion.camera import points_from_depth, project
from nte.motion.warp import pixel_centres

FRAMES = 4  # largest number of frames that are looked at
ENOUGH = 200  # least number of surface points that can tell
SAMPLED = 4096  # points of a frame that are looked at, up to twice as many
EXACT = 2e-3  # a function fits if half of the points miss it by less than this share of the depths' spread
FITS_NOT = 0.1  # no function fits: half of the points miss each of them by more than this share
SAME_SCALE = 1.05  # greatest ratio of the units of depth and position
FLAT = 0.02  # points whose least extent is a smaller share of the greatest lie in a plane, and tell no scale
OFF = 0.005  # 1 − cosine to the surface's own normal, on average, from which on normals do not agree with it: 6°
TURNED = 0.3  # a rotation explains the normals if it leaves at most this share of that
ALONG = 0.95  # cosine, up to its sign, of normals that agree with the surface
SOME = 0.05  # share of the pixels whose normals point away from which on it is told
BESIDE = 2.0  # px: greatest distance at which a camera sees half of the surfaces beside their own pixels
BUFFER = 0.9  # if nearly all depths lie between this and 1, they look like those of a z-buffer
FAR = 100.0  # a depth that many pixels share exactly, this many times the median of the others, is no surface


class _Fit(NamedTuple):
    """How well each function of position explains a frame's depth (errors as shares of its spread), and its scale."""

    axis: float
    distance: float
    buffer: float
    scale: float | None  # depth per unit of position along the axis; None if unknown


class _Turn(NamedTuple):
    """Mean cosines of normals to the surface: as they are, up to their sign, and after the best rotation."""

    given: float
    unsigned: float
    turned: float


@dataclass
class GeometryTally:
    """Tally of what depth, position and normals of a clip's frames say about each other."""

    _fits: list[_Fit] = field(default_factory=list)
    _turns: list[_Turn] = field(default_factory=list)
    _beside: list[float] = field(default_factory=list)  # px: how far from its pixel the camera sees a frame's surface
    _pixels: int = 0
    _alone: int = 0  # pixels that have a depth, but no normal (without normals: no instance)
    _alone_low: float = float("inf")
    _alone_high: float = 0.0
    _others_high: float = 0.0
    _high: float = 0.0
    _least: float = float("inf")  # depth that a tenth of a frame's surfaces do not reach
    _constant: int = 0  # pixels that share one large depth exactly
    _frames: int = 0
    _shown_by: str = "position"  # what tells where surfaces are
    _blank: str = ""  # the channel that shows no surface there

    def add(self, frame: Frame) -> None:
        """Add a PyTorch frame of batch 1; only the first four with depth count."""
        if "depth" not in frame or self._frames >= FRAMES:
            return
        self._frames += 1
        depth = frame["depth"][0, 0].double().nan_to_num(0, 0, 0)
        self._add_misses(frame, depth)
        position = _positions(frame)
        if position is None:
            return
        self._shown_by = "position" if "position" in frame else "depth and cameras"
        hit = (depth > 0) & position.isfinite().all(0) & (position != 0).any(0)
        if int(hit.sum()) < ENOUGH:
            return
        if "position" in frame and frame.view is not None and frame.projection is not None:
            seen = project(position[None], frame.view.double(), frame.projection.double())
            apart = (seen - pixel_centres(seen))[0, :, hit].norm(dim=0).nan_to_num(float("inf"))
            self._beside.append(float(apart.median()))
        step = max(1, int(hit.sum()) // SAMPLED)
        fit, axis = _explain(position[:, hit][:, ::step], depth[hit][::step])
        self._fits.append(fit)
        if "normal" in frame and fit.axis < FITS_NOT and (turn := _turn(frame, position, depth, axis)):
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
            self._least = min(self._least, float(hits.kthvalue(-(-hits.numel() // 10)).values))
            same = hits == hits.max()
            if not same.all() and float(hits.max()) >= FAR * float(hits[~same].median()):
                self._constant += int(same.sum())

    def judge(self) -> Iterator[Finding]:
        """Yield findings about depths of misses, depths of another kind, and normals of another space."""
        yield from self._judge_misses()
        if self._fits:
            yield from self._judge_depth()
        if self._turns:
            yield from self._judge_normals()
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
        if not self._fits and BUFFER < self._least <= self._high <= 1:
            found = f"nine tenths lie between {self._least:.4g} and {self._high:.4g}, as in a z-buffer"
            yield Finding("depth", found, "distances along the view axis, in scene units", False)

    def _judge_depth(self) -> Iterator[Finding]:
        axis = median(fit.axis for fit in self._fits)
        distance, buffer = median(fit.distance for fit in self._fits), median(fit.buffer for fit in self._fits)
        expected = "the distance along the view axis"
        if axis > EXACT and distance < min(axis / 10, EXACT):
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

    def _judge_normals(self) -> Iterator[Finding]:
        given, unsigned, turned = (median(turn[i] for turn in self._turns) for i in range(3))
        away = (1 - given / unsigned) / 2 if unsigned > ALONG else 0.0  # share of the pixels
        if away > SOME:
            where = "most" if given < 0 else f"{away:.0%} of the"
            found = f"point away from the camera in {where} pixels, as {self._shown_by} shows"
            yield Finding("normal", found, "normals that face the camera", False)
        elif 1 - unsigned > OFF and 1 - turned < TURNED * (1 - unsigned):  # a half turn only changes some walls' signs
            found = f"not perpendicular to the surfaces of {self._shown_by}, but one rotation of all makes them so"
            expected = "world space for both (for normals in camera space normal.space=camera, with cameras)"
            yield Finding("normal", found, expected)


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
    squared = distance @ _solve(distance, unit.square())
    # z = A + B/(a·P + b) is a quotient of two linear functions: z (a·P + b) − (c·P + d) = 0.
    quotient = torch.linalg.eigh(_gram(torch.cat([linear * unit[:, None], -linear], 1)))[1][:, 0]
    buffer = (linear @ quotient[4:]) / (linear @ quotient[:4])
    axis = plane[:3] * depth.median() / size
    known = float(extent[0]) > FLAT * float(size)
    errors = error(linear @ plane), error(squared.clamp(min=0).sqrt()), error(buffer)
    return _Fit(*errors, float(axis.norm()) if known else None), axis if known else None


def _solve(rows: Tensor, values: Tensor) -> Tensor:
    """Least squares of rows (n, k) to values (n,), by the normal equations: the rows are centred and of unit size."""
    solved: Tensor = torch.linalg.pinv(_gram(rows), hermitian=True) @ (rows.T @ values)
    return solved


def _gram(rows: Tensor) -> Tensor:
    return rows.T @ rows


def _turn(frame: Frame, position: Tensor, depth: Tensor, axis: Tensor | None) -> _Turn | None:
    """Compare normals with the surface that the positions (3, H, W) of neighbours span; None if too few can tell.

    axis: the view axis (3,); None if unknown, and then normals count as facing the camera.
    """
    if min(depth.shape) < 3:
        return None
    across, down = position[:, 1:-1, 2:] - position[:, 1:-1, :-2], position[:, 2:, 1:-1] - position[:, :-2, 1:-1]
    surface = torch.linalg.cross(across, down, dim=0)
    normal = frame["normal"][0].double()[:, 1:-1, 1:-1]
    around = depth.unfold(0, 3, 1).unfold(1, 3, 1).flatten(2)
    inside = (around.amin(2) > 0) & (around.amax(2) < ONE_SURFACE * around.amin(2))
    inside = inside & surface.isfinite().all(0) & (surface.norm(dim=0) > 0)
    inside = inside & normal.isfinite().all(0) & (normal.norm(dim=0) > 0.5)
    if int(inside.sum()) < ENOUGH:
        return None
    step = max(1, int(inside.sum()) // SAMPLED)
    surface, normal = (values[:, inside][:, ::step] for values in (surface, normal))
    surface, normal = surface / surface.norm(dim=0), normal / normal.norm(dim=0)
    # The sign of the cross product depends on the handedness of the space. In a plane the axis is unknown.
    towards = (axis @ surface if axis is not None else -(surface * normal).sum(0)).median()
    surface = -surface if float(towards) > 0 else surface
    u, _, v = torch.linalg.svd(surface @ normal.T)
    cosine = (surface * normal).sum(0)
    turned = (surface * (u @ v @ normal)).sum(0)
    return _Turn(float(cosine.mean()), float(cosine.abs().mean()), float(turned.mean()))
