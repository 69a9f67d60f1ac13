"""The report of `nte check`: whether a clip's values and motion vectors are plausible."""

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import torch
from torch import Tensor

from nte.checking.blank import BlankTally
from nte.checking.cells import cell_votes
from nte.checking.exposure import ExposureTally
from nte.checking.flips import ORIENTATION, FlipTally
from nte.checking.forward import Returns, judge_returns, returns
from nte.checking.geometry import GeometryTally
from nte.checking.guides import GuideTally
from nte.checking.judge import Judgement, Verdict, judge_frames, judge_votes
from nte.checking.late import LateTally
from nte.checking.objects import object_votes
from nte.checking.order import Order, depth_order, judge_order
from nte.checking.sky import SkyMotion, judge_sky, sky_motion
from nte.checking.spaces import Spaces, changed_alike, judge_spaces
from nte.checking.still import Stillness, stillness, without_motion
from nte.checking.values import Finding, Tally, judge_values, tally_values
from nte.checking.votes import Votes
from nte.frames.clip import Clip
from nte.frames.frame import Frame
from nte.motion.conventions import Convention
from nte.motion.geometric import Reprojection, frame_vectors, traditional_motion
from nte.motion.warp import fetch_nearest, pixel_centres, warp

MOVING_PX = 1.0
CHANGING_ALBEDO = 0.02
PAIRS = 12  # largest number of pairs of frames whose vectors are judged, spread over the clip
COMPARED = ("albedo", "normal", "reference")


@dataclass
class Mean:
    """A mean over pixels that are added frame by frame."""

    total: float = 0.0
    count: int = 0

    def add(self, error: Tensor, where: Tensor) -> None:
        """Add error (1, 1, H, W) at the pixels of the mask `where`."""
        self.total += float(error[where].double().sum())
        self.count += int(where.sum())

    @property
    def value(self) -> float:
        """The mean; NaN without pixels."""
        return self.total / self.count if self.count else float("nan")


@dataclass
class CheckReport:
    """The result of `check`. Errors are means of |difference| over channels and pixels.

    In `errors` vectors are none, traditional or dual, and regions are visible, disoccluded or, for albedo, changing:
    visible pixels that move and whose albedo changes.
    """

    clip: str
    frames: int
    verdict: Verdict
    reason: str
    findings: list[Finding]  # faults of single channels, and notes
    tallies: dict[str, Tally]  # channel → range, mean, bad pixels
    votes: Votes
    errors: dict[tuple[str, str, str], Mean]  # (channel, vectors, region) → error
    disoccluded: float  # share of all pixels
    invalid: float  # share of all pixels whose vector leads out of the previous frame
    convention: Convention | None  # convention of the vectors: nte's, another one, or None if unknown
    telling_frame: int  # the frame with the most disoccluded pixels, for the picture

    @property
    def ratio(self) -> float:
        """Albedo error without vectors over error with traditional ones, in the region changing; NaN if unknown."""
        unwarped, warped = (self.errors.get(("albedo", vectors, "changing")) for vectors in ("none", "traditional"))
        return unwarped.value / warped.value if unwarped and warped and warped.total else float("nan")


@dataclass
class _Vectors:
    """Results collected from pairs of frames."""

    votes: dict[int, Votes] = field(default_factory=dict)  # of each frame
    still: list[Stillness] = field(default_factory=list)
    orders: list[Order] = field(default_factory=list)
    skies: list[SkyMotion] = field(default_factory=list)
    spaces: list[Spaces] = field(default_factory=list)
    returns: list[Returns] = field(default_factory=list)
    errors: dict[tuple[str, str, str], Mean] = field(default_factory=lambda: defaultdict(Mean))
    disoccluded: Mean = field(default_factory=Mean)
    invalid: Mean = field(default_factory=Mean)
    telling: tuple[int, int] = (0, 1)  # most disoccluded pixels, and the frame that has them

    def add(self, previous: Frame, current: Frame, vote: bool) -> None:
        """Add two consecutive frames that have motion. vote: collect votes on the vectors as well, which costs more."""
        dual = frame_vectors(current, previous.get("depth"))
        everywhere = torch.ones_like(dual.valid)
        self.disoccluded.add(dual.disoccluded.float(), everywhere)
        self.invalid.add((~dual.valid).float(), everywhere)
        if (hidden := int(dual.disoccluded.sum())) > self.telling[0]:
            self.telling = hidden, current.index
        _add_errors(self.errors, previous, current, dual)
        if not vote:
            return
        self.still.append(stillness(previous, current))
        self.spaces.append(changed_alike(previous, current, visible_in_both(previous, current, dual)))
        if (of_sky := sky_motion(previous, current)) is not None:
            self.skies.append(of_sky)
        if found := returns(previous, current):
            self.returns.append(found)
        if "depth" in current and "depth" in previous:
            self.orders.append(depth_order(previous, current))
        votes = Votes()
        if "albedo" in current:
            votes.add(cell_votes(previous, current))
        if "instance" in current:
            votes.add(object_votes(previous, current))
        self.votes[current.index] = votes

    def judge(self) -> Iterator[Finding]:
        """Yield what right vectors say of other channels."""
        yield from judge_frames(self.votes)
        yield from judge_order(self.orders)
        yield from judge_sky(self.skies)
        yield from judge_spaces(self.spaces)
        yield from judge_returns(self.returns)


def check(clip: Clip | Path | str) -> CheckReport:
    """Judge whether a clip's values and motion vectors are plausible.

    Every frame is read; the vectors of at most 12 pairs of frames vote. The report has a `verdict` (plausible,
    implausible or undecidable), its `reason`, and a `convention`: the sign, axes, unit and direction that the vectors
    seem to have, or None if that is unknown. Raises NteError for files that cannot be read.

    >>> report = nte.check("data/clips/disc_000")
    >>> report.verdict
    'plausible'
    """
    clip = clip if isinstance(clip, Clip) else Clip(clip)
    tallies: dict[str, Tally] = defaultdict(Tally)
    exposure, flips, guides, geometry = ExposureTally(), FlipTally(), GuideTally(), GeometryTally()
    blank, late, vectors = BlankTally(), LateTally(), _Vectors()
    voting = {round(1 + i * (len(clip) - 2) / max(PAIRS - 1, 1)) for i in range(PAIRS)}
    previous: Frame | None = None
    for frame in clip:
        current = frame.torch()
        tally_values(tallies, current)
        blank.add(current)
        exposure.add(current)
        flips.add(current)
        guides.add(current)
        geometry.add(current)
        if previous is not None and current.index in voting:
            late.add(previous, current)
        if previous is not None and "motion" in current:
            vectors.add(previous, current, current.index in voting)
        previous = current
    judgement = _judge_vectors(clip, vectors)
    along = list(vectors.judge()) if judgement.verdict == "plausible" else []
    light = list(exposure.judge())
    turned = () if ORIENTATION in (f.expected for f in light) else flips.judge()  # the reference is turned over itself
    values = [*judge_values(tallies), *blank.judge()]
    findings = [*values, *light, *turned, *late.judge(), *geometry.judge(), *along, *guides.judge()]
    judgement = _judge(judgement, findings)
    total = Votes()
    for votes in vectors.votes.values():
        total.add(votes)
    return CheckReport(
        clip.name, len(clip), judgement.verdict, judgement.reason, findings, dict(tallies), total, dict(vectors.errors),
        vectors.disoccluded.value, vectors.invalid.value, judgement.convention, min(vectors.telling[1], len(clip) - 1),
    )  # fmt: skip


def _judge(judgement: Judgement, findings: list[Finding]) -> Judgement:
    """The verdict on the clip: impossible values first, then the judgement of its vectors."""
    faults = [f"{finding.channel}: {finding.found}" for finding in findings if finding.fault]
    if not faults:
        return judgement
    also = [judgement.reason] if judgement.verdict == "implausible" else []
    return Judgement("implausible", "; ".join([*faults, *also]), judgement.convention)


def _judge_vectors(clip: Clip, vectors: _Vectors) -> Judgement:
    missing = [name for name in ("albedo", "motion") if name not in clip.channels]
    if "motion" in missing or not {"albedo", "instance"} & {*clip.channels}:
        return Judgement("undecidable", f"vectors not checked: that needs albedo and motion, without {missing[0]}")
    if len(clip) < 2:
        return Judgement("undecidable", "vectors not checked: that needs two frames")
    judgement = judge_votes(list(vectors.votes.values()))
    if judgement.verdict != "implausible" and (stuck := without_motion(vectors.still)):
        return Judgement("implausible", stuck)
    return judgement


def visible_in_both(previous: Frame, current: Frame, vectors: Reprojection) -> Tensor:
    """Mark the pixels whose surface is visible in both frames, as a bool mask (1, 1, H, W).

    The vector is valid, the surface is not disoccluded, and all four pixels that are fetched show the same instance,
    if both frames have `instance`. vectors: the dual vectors of `current`.
    """
    visible = vectors.valid & ~vectors.disoccluded
    if "instance" in current and "instance" in previous:
        position = pixel_centres(current["motion"]) + vectors.motion
        for corner in ((-0.5, -0.5), (0.5, -0.5), (-0.5, 0.5), (0.5, 0.5)):
            tap = position + position.new_tensor(corner).view(1, 2, 1, 1)
            visible = visible & (fetch_nearest(previous["instance"], tap) == current["instance"])
    return visible


def _difference(a: Tensor, b: Tensor) -> Tensor:
    return (a - b).abs().mean(1, keepdim=True)


def _add_errors(errors: dict[tuple[str, str, str], Mean], previous: Frame, current: Frame, dual: Reprojection) -> None:
    traditional = traditional_motion(current["motion"])
    visible = visible_in_both(previous, current, dual)
    regions = {"visible": visible, "disoccluded": dual.disoccluded & dual.valid}
    for name in (name for name in COMPARED if name in current and name in previous):
        fetched = {
            "none": previous[name],
            "traditional": warp(previous[name], traditional.motion).image,
            "dual": warp(previous[name], dual.motion).image,
        }
        finite = (current[name].isfinite() & fetched["none"].isfinite()).all(1, keepdim=True)
        if name == "albedo":
            moving = traditional.motion.square().sum(1, keepdim=True) > MOVING_PX**2
            changes = _difference(current[name], previous[name]) > CHANGING_ALBEDO
            regions = {**regions, "changing": visible & moving & changes}
        for vectors, image in fetched.items():
            difference = _difference(current[name], image)
            for region, where in regions.items():
                errors[name, vectors, region].add(difference, where & finite & difference.isfinite())
