"""A check that depth, position, normals and camera of one frame belong together: they show the same surfaces.

The depth of a point along the view axis is a linear function of its position, whatever the camera. Distances from the
camera and z-buffers are other functions of it; a panorama, which sees points in all directions, has nothing but the
distance. A camera sees every position in its own pixel. Where there is a camera and no position, position is made from
depth. Normals are compared with positions in `nte.checking.normals`.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from statistics import median, median_high, median_low
from typing import cast

import torch
from torch import Tensor

from nte.checking.kinds import EXACT, KINDS, Fit, explain
from nte.checking.normals import Turn, judge_turns, turn_of
from nte.checking.origin import Origin, judge_origins, origin_of
from nte.checking.values import MANY, Finding
from nte.frames.frame import Frame
from nte.motion.camera import points_from_depth, project
from nte.motion.warp import pixel_centres

ENOUGH = 200  # least number of surface points that can tell
SAMPLED = 4096  # points of a frame that are looked at, up to twice as many
NEAR = 3.0  # median depths within which points tell sides where all of them lie in a plane
FITS_NOT = 0.1  # no function fits: half of the points miss each of them by more than this share
SAME_SCALE = 1.05  # greatest ratio of the units of depth and position
PANORAMA = 0.1  # a greater share of the points behind: no camera with a view axis sees them all
BESIDE = 2.0  # px: greatest distance at which a camera sees half of the surfaces beside their own pixels
FAR = 100.0  # a depth that many pixels share exactly, this many times the median of the others, is no surface


@dataclass
class GeometryTally:
    """Tally of what depth, position and normals of a clip's frames say about each other."""

    _fits: list[Fit] = field(default_factory=list)
    _turns: list[Turn] = field(default_factory=list)
    _origins: list[Origin] = field(default_factory=list)
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
        steps = rounding(position, hit) if "position" in frame else torch.zeros_like(position)
        if "position" in frame and frame.view is not None and frame.projection is not None:
            seen = project(position[None], frame.view.double(), frame.projection.double())
            apart = (seen - pixel_centres(seen))[0, :, hit].norm(dim=0).nan_to_num(float("inf"))
            for each in range(3):  # rounding moves a point by up to half a step along each
                off = steps * torch.eye(3, dtype=steps.dtype)[each].view(3, 1, 1) / 2
                moved = project((position + off)[None], frame.view.double(), frame.projection.double()) - seen
                apart -= moved[0, :, hit].norm(dim=0).nan_to_num(0.0)
            self._beside.append(float(apart.clamp(min=0).median()))
        spanning, fits = None, True
        if depth is not None:
            step = max(1, int(hit.sum()) // SAMPLED)
            known = position, depth, steps.norm(dim=0)
            fit, axis = explain(*(values[..., hit][..., ::step] for values in known))
            self._fits.append(fit)
            fits = fit.axis < FITS_NOT
            spanning = None if axis is None else hit
            if axis is None:  # before a ground that reaches a horizon all else is flat
                near = hit & (depth < NEAR * depth[hit].median())
                spanning = (
                    near if explain(*(values[..., near][..., ::step] for values in known))[1] is not None else None
                )
            if "position" in frame and axis is not None and fit.axis <= EXACT:
                pixels = pixel_centres(depth[None, None])[0, :, hit][:, ::step]
                self._origins.append(origin_of(position[:, hit][:, ::step], pixels, depth[hit][::step]))
        if "normal" in frame and fits:
            turn = turn_of(frame["normal"][0].double(), position, hit, depth, spanning, steps.norm(dim=0))
            self._turns += [turn] if turn else []

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
        elsewhere = list(judge_origins(self._origins))
        yield from elsewhere
        if not elsewhere:  # whose depth may point the other way
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
            surely = self._blank == "normal"  # engines may number only some of the things
            told = f"{found}, beyond all surfaces" if beyond else found
            yield Finding("depth", told, expected, beyond and surely, beyond and not surely)
        elif self._constant > MANY * self._pixels:
            share = f"{self._constant / self._pixels:.1%} of the pixels have exactly the greatest depth"
            found = f"{share}, {self._high:.4g}, over {FAR:.0f} times that of the others"
            yield Finding("depth", found, expected, False)

    def _judge_depth(self) -> Iterator[Finding]:
        axis = median(fit.axis for fit in self._fits)
        expected = "the distance along the view axis"
        errors = {name: median(getattr(fit, name) for fit in self._fits) for name in KINDS}
        least = min(errors.values())
        if axis > EXACT and least < min(axis / 10, EXACT):
            name = next(name for name, error in errors.items() if error <= 2 * least)
            if name == "distance" and median(fit.behind for fit in self._fits) > PANORAMA:
                return
            imported = " (on import depth.along=ray)" if name == "distance" else ""
            yield Finding("depth", f"is {KINDS[name]}, as position shows", expected + imported)
        elif axis > FITS_NOT:
            yield Finding("depth", "does not belong to position: no camera sees both", expected)
        else:
            yield from self._judge_scale()

    def _judge_scale(self) -> Iterator[Finding]:
        scales = [fit.scale for fit in self._fits if fit.scale is not None]
        if not scales:
            return
        # Of two units the factor between them is that of no frame.
        typical = [scale(scales) for scale in (median_low, median_high)]
        off = [scale for scale in typical if not 1 / SAME_SCALE < scale < SAME_SCALE]
        if max(scales) > SAME_SCALE**2 * min(scales):
            found = f"is {min(scales):.4g} to {max(scales):.4g} times as long as position shows, as frames differ"
            yield Finding("depth", found, "the units of position in all frames", bool(off))
        elif off:
            yield Finding("depth", f"is {off[0]:.4g} times as long as position shows", "the units of position")


def rounding(position: Tensor, hit: Tensor) -> Tensor:
    """Steps (3, H, W) to which positions are rounded: those of half floats, if all where `hit` (H, W) are such values.

    Away from the origin they may be longer than from pixel to pixel.
    """
    values = position[:, hit]
    halves = bool((values.half().double() == values).all())
    bits, least = (10, -14) if halves else (23, -126)
    exponents = position.abs().nan_to_num(0, 0, 0).clamp(min=2.0**least).log2().floor()
    return (exponents - bits).exp2()


def _positions(frame: Frame) -> Tensor | None:
    """World points (3, H, W) of the surfaces, from position, or else from depth and camera; None without both."""
    if "position" in frame:
        return cast(Tensor, frame["position"][0].double())
    if frame.view is None or frame.projection is None:
        return None
    return points_from_depth(frame["depth"].double(), frame.view.double(), frame.projection.double())[0]
