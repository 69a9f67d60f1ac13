"""The report of `nte check`: whether a clip's values and motion vectors are plausible."""

from collections import defaultdict
from dataclasses import dataclass, replace
from pathlib import Path

from nte.checking.albedo import SEEN, AlbedoTally
from nte.checking.blank import BlankTally, StoppedTally
from nte.checking.cameras import judge_cameras
from nte.checking.components import ComponentTally
from nte.checking.copies import CopyTally
from nte.checking.displaced import DisplacedTally
from nte.checking.enlarged import EnlargedTally
from nte.checking.exposure import ExposureTally
from nte.checking.flips import ORIENTATION, FlipTally
from nte.checking.geometry import GeometryTally
from nte.checking.judge import Judgement, Verdict, judge_votes
from nte.checking.late import LateTally
from nte.checking.noise import NoiseTally
from nte.checking.order import is_known
from nte.checking.outlines import OutlineTally
from nte.checking.pairs import PairTally
from nte.checking.planes import PlaneTally
from nte.checking.residuals import Mean
from nte.checking.still import without_motion
from nte.checking.tone import EXPECTED as LINEAR
from nte.checking.values import Finding, Tally, judge_values, tally_values
from nte.checking.votes import Votes
from nte.frames.clip import Clip
from nte.frames.frame import Frame
from nte.frames.guides import GuideTally
from nte.frames.sample import FRAMES, PAIRS, spread
from nte.motion.conventions import Convention


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
    not_judged: dict[str, str]  # channel → why it could not be judged, though nothing was found

    @property
    def ratio(self) -> float:
        """Albedo error without vectors over error with traditional ones, in the region changing; NaN if unknown."""
        unwarped, warped = (self.errors.get(("albedo", vectors, "changing")) for vectors in ("none", "traditional"))
        return unwarped.value / warped.value if unwarped and warped and warped.total else float("nan")


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
    blank, stopped, late, planes, vectors = BlankTally(), StoppedTally(), LateTally(), PlaneTally(), PairTally()
    displaced, copies, components, noise = DisplacedTally(), CopyTally(clip), ComponentTally(), NoiseTally()
    albedo, outlines, enlarged = AlbedoTally(), OutlineTally(), EnlargedTally()
    of_frames = flips, displaced, albedo, components, geometry, planes, outlines, enlarged
    looked, voting = spread(FRAMES, 0, len(clip)), spread(PAIRS, 1, len(clip))
    previous: Frame | None = None
    for frame in clip:
        current = frame.torch()
        tally_values(tallies, current)
        blank.add(current)
        exposure.add(current)
        if current.index in looked:
            copies.add(current, previous)
            guides.add(frame)
            for tally in of_frames:
                tally.add(current)
        if previous is not None:
            noise.add(previous, current, current.index in voting)
        if previous is not None and current.index in voting:
            late.add(previous, current)
        if previous is not None and "motion" in current:
            stopped.add(previous, current)
            vectors.add(previous, current, current.index in voting)
        previous = current
    judgement = _judge_vectors(clip, vectors)
    right = judgement.verdict == "plausible"
    beside = list(displaced.judge())
    of_other_frames = list(late.judge(any(finding.channel == "reference" for finding in beside)))
    late_channels = {finding.channel for finding in of_other_frames}
    # What moves along with a camera lies elsewhere in another frame, too.
    of_other_frames += [f for f in beside if not {f.channel, "reference"} & late_channels]
    late_channels |= {finding.channel for finding in of_other_frames}
    light = [f for f in exposure.judge() if f.expected != LINEAR or "reference" not in late_channels]
    turned = () if ORIENTATION in (f.expected for f in light) else flips.judge()  # the reference is turned over itself
    colours = [] if any(f.fault for f in light) or "albedo" in late_channels else list(albedo.judge())
    # What is late in one channel looks like another fault beside right ones: only the cause is told.
    along = [f for f in vectors.judge() if f.channel not in late_channels] if right else []
    singles = (blank, stopped, components, enlarged)
    known = "reference" not in late_channels
    of_one_light = [*copies.judge(known), *noise.judge(known and not any(finding.fault for finding in light))]
    values = [*judge_values(tallies), *(finding for tally in singles for finding in tally.judge()), *of_one_light]
    units = vectors.judge_units() if judgement.verdict != "implausible" else ()  # wrong vectors lead elsewhere
    shapes = [*geometry.judge(), *planes.judge(), *units]
    if judgement.verdict != "implausible" and not any(f.fault for f in shapes):
        along += judge_cameras(vectors.predictions)
    if judgement.verdict == "implausible" and any(f.doubt and f.expected == SEEN for f in colours):
        judgement = Judgement("undecidable", "vectors not checked: that needs the albedo of what is seen")
    findings = [*values, *of_other_frames, *light, *colours, *turned, *shapes, *along]
    if not any(f.channel == "depth" and (f.fault or f.doubt) for f in findings):  # which has other steps, too
        findings += outlines.judge()
    findings += (Finding(*flaw, False) for flaw in guides.flaws())  # only denoisers that trust guides suffer
    judgement = _judge(judgement, findings)
    unknown = {"reference": exposure.not_judged(), "depth": planes.not_judged(right and is_known(vectors.orders))}
    told = {finding.channel for finding in findings}
    not_judged = {name: why for name, why in unknown.items() if why and name not in told}
    return CheckReport(
        clip.name, len(clip), judgement.verdict, judgement.reason, findings, dict(tallies), vectors.total_votes(),
        dict(vectors.errors), vectors.disoccluded.value, vectors.invalid.value, judgement.convention,
        min(vectors.telling[1], len(clip) - 1), not_judged,
    )  # fmt: skip


def _judge(judgement: Judgement, findings: list[Finding]) -> Judgement:
    """The verdict on the clip. Faults and doubts of channels come first: vectors are judged by these channels."""
    faults = [f"{finding.channel}: {finding.found}" for finding in findings if finding.fault]
    doubts = [f"{finding.channel}: {finding.found}" for finding in findings if finding.doubt]
    if not faults and doubts and judgement.verdict == "plausible":
        return Judgement("undecidable", "; ".join(doubts), judgement.convention)
    if not faults:
        return replace(judgement, reason="; ".join([*doubts, judgement.reason]))
    also = [judgement.reason] if judgement.verdict == "implausible" else []
    return Judgement("implausible", "; ".join([*faults, *also]), judgement.convention)


def _judge_vectors(clip: Clip, vectors: PairTally) -> Judgement:
    missing = [name for name in ("albedo", "motion") if name not in clip.channels]
    if "motion" in missing or not {"albedo", "instance"} & {*clip.channels}:
        return Judgement("undecidable", f"vectors not checked: that needs albedo and motion, without {missing[0]}")
    if len(clip) < 2:
        return Judgement("undecidable", "vectors not checked: that needs two frames")
    judgement = judge_votes(list(vectors.votes.values()), list(vectors.votes))
    if judgement.verdict == "implausible" or vectors.judge_units():  # else what changes is the unit of depth
        return judgement
    if stuck := without_motion(vectors.still):
        return Judgement("implausible", stuck)
    return judgement
