"""Are a clip's vectors and values plausible? (nte check; the criteria are in datasets/README.md)

Albedo travels with its surface, so the previous frame's albedo, warped with correct vectors, must explain
the current one. If it does not, other conventions are tried, and the one that fits is named.
"""

from collections import defaultdict
from dataclasses import dataclass, field
from typing import Literal

import torch
from torch import Tensor

from nte.errors import NteError
from nte.frames.bad import count_bad
from nte.frames.channels import CHANNELS
from nte.frames.clip import Clip
from nte.frames.frame import Frame
from nte.motion.conventions import CONVENTIONS, Convention
from nte.motion.geometric import (
    Reprojection,
    dual_motion,
    frame_vectors,
    scatter_forward_motion,
    traditional_motion,
)
from nte.motion.warp import fetch_nearest, pixel_centres, warp

MOVING_PX = 1.0
CHANGING_ALBEDO = 0.02
ENOUGH_PIXELS = 100
SANITISED = ("radiance", "reflectance")  # kinds whose bad pixels denoisers take care of
MUST_EXPLAIN = 0.5  # of the unwarped error, at the most
FITS_BETTER = 0.8  # another convention with less than this share of the error is the right one

Verdict = Literal["plausible", "undecidable", "implausible"]
COMPARED = ("albedo", "normal", "reference")


@dataclass
class Mean:
    """A mean over pixels that arrive frame by frame."""

    total: float = 0.0
    count: int = 0

    def add(self, error: Tensor, where: Tensor) -> None:
        """Add error (1, 1, H, W) at the pixels of the mask `where`."""
        self.total += float(error[where].double().sum())
        self.count += int(where.sum())

    @property
    def value(self) -> float:
        """The mean, NaN without pixels."""
        return self.total / self.count if self.count else float("nan")


@dataclass
class Fit:
    """How well one convention explains the albedo, against no motion and the vectors as they are."""

    warped: Mean = field(default_factory=Mean)
    given: Mean = field(default_factory=Mean)
    unwarped: Mean = field(default_factory=Mean)


@dataclass
class Statistics:
    """Range of a channel over the clip, its mean over finite values, and its bad pixels."""

    low: float = float("inf")
    high: float = -float("inf")
    mean: Mean = field(default_factory=Mean)
    bad: int = 0


@dataclass
class CheckReport:
    """What `check_clip` found. Errors are means of |difference| over channels and pixels."""

    clip: str
    frames: int
    verdict: Verdict
    reason: str
    fits: dict[Convention, Fit]
    errors: dict[tuple[str, str, str], Mean]  # (channel, vectors, region) → error
    statistics: dict[str, Statistics]
    disoccluded: float  # shares of all pixels
    invalid: float
    convention: Convention | None  # that the vectors follow: ours, another one, or none that is known
    telling_frame: int  # the one with the most disoccluded pixels, for the picture

    @property
    def ratio(self) -> float:
        """Unwarped over warped albedo error on the pixels looked at: how much the vectors explain."""
        fit = self.fits[Convention()]
        return fit.unwarped.value / fit.warped.value if fit.warped.total else float("nan")


def check_clip(clip: Clip) -> CheckReport:
    """Look at every frame of a clip; raises NteError for files that cannot be read or lack what it takes."""
    missing = [name for name in ("albedo", "motion") if name not in clip.channels]
    if missing:
        have = ", ".join(clip.channels)
        raise NteError(f"{clip.folder}: nte check needs {' and '.join(missing)}; the clip has {have}")
    fits: dict[Convention, Fit] = defaultdict(Fit)
    fits[Convention()] = Fit()
    errors: dict[tuple[str, str, str], Mean] = defaultdict(Mean)
    statistics: dict[str, Statistics] = defaultdict(Statistics)
    disoccluded, invalid = Mean(), Mean()
    previous: Frame | None = None
    telling, most = min(1, len(clip) - 1), 0
    for frame in clip:
        current = frame.torch()
        _add_statistics(statistics, current)
        if previous is not None:
            dual = frame_vectors(current, previous.get("depth"))
            everywhere = torch.ones_like(dual.valid)
            hidden = int(dual.disoccluded.sum())
            telling, most = (frame.index, hidden) if hidden > most else (telling, most)
            disoccluded.add(dual.disoccluded.float(), everywhere)
            invalid.add((~dual.valid).float(), everywhere)
            _add_fits(fits, previous, current)
            _add_errors(errors, previous, current, dual)
        previous = current
    verdict, reason, convention = _judge(fits, statistics)
    return CheckReport(
        clip.name, len(clip), verdict, reason, dict(fits), dict(errors), dict(statistics),
        disoccluded.value, invalid.value, convention, telling,
    )  # fmt: skip


def visible_in_both(previous: Frame, current: Frame, vectors: Reprojection) -> Tensor:
    """(1, 1, H, W): nothing hid the surface, and all four pixels that are fetched show the same instance."""
    visible = vectors.valid & ~vectors.disoccluded
    if "instance" in current and "instance" in previous:
        position = pixel_centres(current["motion"]) + vectors.motion
        for corner in ((-0.5, -0.5), (0.5, -0.5), (-0.5, 0.5), (0.5, 0.5)):
            tap = position + position.new_tensor(corner).view(1, 2, 1, 1)
            visible = visible & (fetch_nearest(previous["instance"], tap) == current["instance"])
    return visible


def _difference(a: Tensor, b: Tensor) -> Tensor:
    return (a - b).abs().mean(1, keepdim=True)


def _add_fits(fits: dict[Convention, Fit], previous: Frame, current: Frame) -> None:
    """Add a frame to every convention's fit, each on the pixels that it would make visible in both frames.

    Hidden pixels are found by scattering the vectors under test, never with the stored forward motion: that
    one may be right where `motion` is wrong, and would declare the whole image disoccluded.
    """
    albedo, before = current["albedo"], previous["albedo"]
    unwarped = _difference(albedo, before)
    given_error = _difference(albedo, warp(before, traditional_motion(current["motion"]).motion).image)
    no_depth = torch.zeros_like(albedo[:, :1])
    depths = [no_depth if frame.get("depth") is None else frame["depth"] for frame in (previous, current)]
    for convention in CONVENTIONS:
        motion = convention.convert(current["motion"], previous["motion"], depths[0])
        vectors = dual_motion(motion, scatter_forward_motion(motion, depths[1]), depths[1], depths[0])
        vectors = vectors._replace(motion=traditional_motion(motion).motion)
        moving = vectors.motion.square().sum(1, keepdim=True) > MOVING_PX**2
        where = visible_in_both(previous, current, vectors) & moving & (unwarped > CHANGING_ALBEDO)
        fit = fits[convention]
        fit.warped.add(_difference(albedo, warp(before, vectors.motion).image), where)
        fit.given.add(given_error, where)
        fit.unwarped.add(unwarped, where)


def _add_errors(errors: dict[tuple[str, str, str], Mean], previous: Frame, current: Frame, dual: Reprojection) -> None:
    traditional = traditional_motion(current["motion"])
    regions = {"visible": visible_in_both(previous, current, dual), "disoccluded": dual.disoccluded & dual.valid}
    for name in (name for name in COMPARED if name in current):
        fetched = {
            "none": previous[name],
            "traditional": warp(previous[name], traditional.motion).image,
            "dual": warp(previous[name], dual.motion).image,
        }
        for vectors, image in fetched.items():
            difference = _difference(current[name], image)
            for region, where in regions.items():
                errors[name, vectors, region].add(difference, where)


def _add_statistics(statistics: dict[str, Statistics], frame: Frame) -> None:
    bad = count_bad(frame)
    for name, values in frame.channels.items():
        entry = statistics[name]
        finite = values[values.isfinite()]
        if finite.numel():
            entry.low = min(entry.low, float(finite.min()))
            entry.high = max(entry.high, float(finite.max()))
        entry.mean.add(finite, torch.ones_like(finite, dtype=torch.bool))
        entry.bad += bad.get(name, 0)


def _judge(fits: dict[Convention, Fit], statistics: dict[str, Statistics]) -> tuple[Verdict, str, Convention | None]:
    """Verdict, reason, and the convention that explains the albedo, where one does."""
    geometry = {name: s.bad for name, s in statistics.items() if s.bad and CHANNELS[name].kind not in SANITISED}
    if geometry:
        listed = ", ".join(f"{number} pixels of {name}" for name, number in geometry.items())
        return "implausible", f"geometry is not finite: {listed}", None
    given, best = fits[Convention()], _best_convention(fits)
    fit = fits[best]
    if best != Convention() and fit.warped.value < min(
        FITS_BETTER * fit.given.value, MUST_EXPLAIN * fit.unwarped.value
    ):
        errors = f"{fit.warped.value:.3f} instead of {fit.given.value:.3f}"
        return "implausible", f"'motion' has another convention: {best}: albedo error {errors}", best
    if given.warped.count < ENOUGH_PIXELS:
        found = f"only {given.warped.count} moving pixels with changing albedo"
        return "undecidable", f"{found}, {ENOUGH_PIXELS} are needed", None
    errors = f"warped {given.warped.value:.4f}, unwarped {given.unwarped.value:.4f}"
    if given.warped.value > MUST_EXPLAIN * given.unwarped.value:
        return "implausible", f"'motion' does not explain the albedo: {errors}, and no known convention fits", None
    return "plausible", f"albedo error on {given.warped.count} moving pixels: {errors}", Convention()


def _best_convention(fits: dict[Convention, Fit]) -> Convention:
    """The convention with the smallest share of the given vectors' error.

    It must speak for the clip: a unit that blows up the nearly still pixels finds a few that it explains by
    chance. At constant speed «forward» and «opposite sign» say the same; the simpler one is named unless the
    other explains twice as much.
    """
    enough = max(ENOUGH_PIXELS, fits[Convention()].warped.count // 2)

    def share(convention: Convention) -> float:
        fit = fits[convention]
        if convention == Convention():
            return 1.0
        if fit.warped.count < enough:
            return float("inf")
        handicap = 2.0 if convention.forward else 1.0
        return handicap * fit.warped.value / max(fit.given.value, 1e-12)

    return min(fits, key=share)
