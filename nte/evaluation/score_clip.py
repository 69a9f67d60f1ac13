"""The evaluation of one clip, frame by frame: each denoiser's scores against the reference, and its times."""

import statistics
import warnings
from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import torch
from torch import Tensor

from nte.denoiser import Denoiser, Noisy
from nte.errors import NteError
from nte.evaluation.metric_table import METRICS, Row
from nte.evaluation.metrics import Scores, region_mean, regions_of, score, temporal_l1, temporal_l1_floor
from nte.evaluation.record import record_extras, record_frame, record_kernels, record_output
from nte.evaluation.targets import Truth, displayed, picture, read_truth
from nte.evaluation.timed import Timed
from nte.frames.ahead import with_next
from nte.frames.channels import reference_of
from nte.frames.clip import Clip
from nte.frames.frame import Array, Frame
from nte.frames.reference import BadReferenceWarning, describe_bad_pixels
from nte.frames.scalars import sequence_exposure
from nte.frames.show import RGB, heat, quantise
from nte.models.applied import overheard
from nte.session import Session
from nte.viewer.recorder import Recorder

SCORED = tuple(metric.name for metric in METRICS if metric.name != "ms_per_frame")


@dataclass(frozen=True)
class Shown:
    """Pictures of one target in one frame of a clip, for the report: input, reference, each output and its FLIP map."""

    clip: str
    target: str
    frame: int
    disoccluded: int  # number of disoccluded pixels
    images: dict[str, RGB] = field(default_factory=dict)  # noisy input, reference, then one for each spec
    flip: dict[str, RGB] = field(default_factory=dict)  # one for each spec

    def only(self, specs: Container[str]) -> "Shown":
        """Return the pictures without those of other specs; input and reference stay."""
        images = {name: image for name, image in self.images.items() if name in specs or name not in self.flip}
        return replace(self, images=images, flip={name: self.flip[name] for name in self.flip if name in specs})


class ClipRun:
    """A run of denoisers (spec → denoiser) over one clip.

    Call `advance` for each frame in order; the results then are `rows` and `shown`. A denoiser that filters light
    components apart (`components`) is also scored on each of them, if the clip has its reference and `lights` (None:
    all) has its name. Frames before `first` fill the history and are not scored. label: the clip's name. recorder: gets
    the pixels of every frame, for the viewer. Frames are scored in the exposure that they give, or else in that of the
    frames before, at first that of the first frame with light. A denoiser that fails, or whose output cannot be scored,
    takes no further part: `failed` has its spec and the error. Raises NteError for a reference that cannot be scored.
    """

    def __init__(
        self, label: str, clip: Clip, denoisers: Mapping[str, Denoiser], device: str,
        first: int = 1, lights: Sequence[str] | None = None, recorder: Recorder | None = None,
    ) -> None:  # fmt: skip
        self.label, self.clip, self.first, self.device = label, clip, first, device
        self.recorder = recorder
        self.exposure = torch.ones(1)  # (1,), of the last frame
        self._known: Array | None = None  # the same, NaN until a frame has light
        scored = [name for name in clip.channels if lights is None or name in map(reference_of, lights)]
        extras = recorder is not None and recorder.recording.extras
        self.runs = [_Run(spec, denoiser, scored, device, extras) for spec, denoiser in denoisers.items()]
        self.targets = list(dict.fromkeys(target for run in self.runs for target in run.scorers))
        self.truths: dict[str, Truth] = {}
        self.shown: dict[str, Shown] = {}  # by target
        self.failed: dict[str, str] = {}  # spec → what went wrong
        self._depth: Tensor | None = None  # depth of the previous frame
        self._frames = with_next(clip, [name for denoiser in denoisers.values() for name in denoiser.optional])
        self._told: set[str] = set()  # targets with a warning about bad pixels

    @torch.no_grad()
    def advance(self, index: int) -> None:
        """Read a frame, let every denoiser step, and score the outputs. Frames must come in order from 0."""
        frame = next(self._frames).torch()
        on_device = frame.torch(self.device)
        before = self.truths
        self._known = sequence_exposure(frame, self._known)
        self.exposure = torch.from_numpy(self._known).nan_to_num(1)
        self.truths = {target: read_truth(frame, target, self.exposure, self.label) for target in self.targets}
        self._tell_bad_pixels(index)
        regions = regions_of(frame, self._depth)
        self._depth = frame.get("depth")
        scored = index >= self.first
        chosen = scored and self._choose(frame, regions)
        if self.recorder:
            record_frame(self.recorder, frame, self.targets, regions.get("disoccluded"))
        for run in list(self.runs):
            try:
                with overheard() as applications:
                    images = self._step(run, on_device)
            except NteError as error:
                self._drop(run, str(error))
                continue
            for target, (output, image) in images.items():
                scorer = run.scorers[target]
                maps: dict[str, Tensor] = {}
                if scored:
                    maps = scorer.score(image, self.truths[target], before.get(target), regions)
                    if chosen:
                        self.shown[target].images[run.spec] = picture(output, target, self.exposure)
                        self.shown[target].flip[run.spec] = quantise(heat(maps["flip"][0, 0].numpy(), "magma"))
                if self.recorder:
                    record_output(self.recorder, index, run.spec, target, output, maps.get("flip"))
                scorer.before = image
            if self.recorder:
                record_extras(self.recorder, index, run.spec, run.further)
                record_kernels(self.recorder, index, run.spec, run.denoiser.components, applications)
        if self.recorder:
            self.recorder.end_frame(index)

    def _step(self, run: "_Run", frame: Frame) -> dict[str, tuple[Tensor, Tensor]]:
        """Denoise a frame: target → output, and the same as it is displayed."""
        where = f"{run.spec} on {self.label}, frame {frame.index}"
        outputs = {target: output.cpu() for target, output in run.step(frame).items()}
        return {
            target: (output, displayed(output, target, self.exposure, where, frame.size))
            for target, output in outputs.items()
        }

    def _drop(self, run: "_Run", why: str) -> None:
        self.failed[run.spec] = why
        if self.recorder:
            self.recorder.drop(run.spec, why)
        self.runs.remove(run)
        for shown in self.shown.values():
            shown.images.pop(run.spec, None)
            shown.flip.pop(run.spec, None)

    def _tell_bad_pixels(self, index: int) -> None:
        for target, truth in self.truths.items():
            if truth.bad and target not in self._told:
                self._told.add(target)
                told = describe_bad_pixels(truth.bad, reference_of(target), self.label, index)
                warnings.warn(told, BadReferenceWarning, stacklevel=3)

    def rows(self) -> list[Row]:
        """Make the rows of metrics.json, one per denoiser, target and region."""
        return [
            {
                "denoiser": run.spec,
                "clip": self.label,
                "target": target,
                "region": region,
                "first_frame": self.first == 0,
                "scored_from": self.first,
                **scorer.summary(region),
                "ms_per_frame": run.ms_per_frame,
                **({"settings": run.settings} if run.settings else {}),
            }
            for run in self.runs
            for target, scorer in run.scorers.items()
            for region in scorer.regions
        ]

    def _choose(self, frame: Frame, regions: Mapping[str, Tensor]) -> bool:
        """Tell whether this frame is the best one to show so far; if so, start its pictures with input and reference.

        The frame with the most disoccluded pixels is shown, as denoisers differ most there; the last of equals has
        the longest history. So the data chooses the frame, not the results.
        """
        disoccluded = int(regions["disoccluded"].sum()) if "disoccluded" in regions else 0
        if any(disoccluded < shown.disoccluded for shown in self.shown.values()):
            return False
        for target in self.targets:
            images = {"reference": picture(frame[reference_of(target)], target, self.exposure)}
            if target in frame and not any(type(run.denoiser) is Noisy and target in run.scorers for run in self.runs):
                images = {"noisy input": picture(frame[target], target, self.exposure), **images}
            self.shown[target] = Shown(self.label, target, frame.index, disoccluded, images)
        if self.recorder:
            self.recorder.centre(frame.index)
        return True


class _Run:
    """One denoiser on one clip: its session, its times, and a scorer for each of its outputs."""

    def __init__(self, spec: str, denoiser: Denoiser, channels: Iterable[str], device: str, extras: bool) -> None:
        self.spec, self.denoiser = spec, denoiser
        self.timed = Timed(denoiser, device)
        self.session = Session(self.timed)
        self.components = tuple(name for name in denoiser.components if reference_of(name) in channels)
        self.scorers = {target: _Scorer() for target in (denoiser.target, *self.components)}
        self.extras = tuple(name for name in denoiser.extras if extras and name not in denoiser.components)
        self.further: Mapping[str, Tensor] = {}  # what it gave besides its images in the last step
        self.settings = ""  # the options that an adaptive denoiser takes on this clip

    def step(self, frame: Frame) -> dict[str, Tensor]:
        """Denoise a frame: target → output. The denoiser sees only the channels that it asks for, so no reference."""
        wanted = (*self.denoiser.needs, *self.denoiser.optional)
        visible = replace(frame, channels={name: frame[name] for name in wanted if name in frame})
        self.settings = self.denoiser.settings(visible)
        result = self.session.step(visible, (*self.components, *self.extras))
        self.further = {name: result.extras[name] for name in self.extras}
        return {self.denoiser.target: result.image, **{name: result.extras[name] for name in self.components}}

    @property
    def ms_per_frame(self) -> float:
        """Median time of a step in milliseconds, without the first frame, which starts the sequence."""
        return 1000 * statistics.median(self.timed.seconds[1:] or self.timed.seconds)


class _Scorer:
    """The scores of one output of one denoiser on one clip, and its previous image."""

    def __init__(self) -> None:
        self.before: Tensor | None = None
        self.scores: list[Scores] = []

    def score(
        self, image: Tensor, truth: Truth, before: Truth | None, regions: Mapping[str, Tensor]
    ) -> dict[str, Tensor]:
        """Add the scores of one frame; return its error maps.

        Unusable pixels of the reference belong to no region, and count as free of error in windows around them.
        """
        seen = {region: pixels & truth.usable for region, pixels in regions.items()}
        scores, maps = score(torch.where(truth.usable, image, truth.image), truth.image, seen)
        if before and self.before is not None:
            maps["temporal_l1"] = temporal_l1(image, self.before, truth.image, before.image)
            if truth.halves and before.halves:
                (a, b), (a_before, b_before) = truth.halves, before.halves
                maps["temporal_l1_floor"] = temporal_l1_floor(a, a_before, b, b_before)
        for name in ("temporal_l1", "temporal_l1_floor"):
            for region, values in scores.items():
                compared = seen[region] & before.usable if before else seen[region]
                values[name] = region_mean(maps[name], compared) if name in maps else None
        self.scores.append(scores)
        return maps

    @property
    def regions(self) -> list[str]:
        """The regions that any frame had, in order."""
        return list(dict.fromkeys(region for scores in self.scores for region in scores))

    def summary(self, region: str) -> Row:
        """The numbers of a row of metrics.json for a region: means over the frames that have any of its pixels."""
        per_frame = {name: [scores.get(region, {}).get(name) for scores in self.scores] for name in SCORED}
        return {
            "frames": sum(value is not None for value in per_frame["psnr"]),
            **{name: mean(values) for name, values in per_frame.items()},
            "per_frame": per_frame,
        }


def mean(values: Iterable[float | None]) -> float | None:
    """Average the values that are not None; None if there are none."""
    numbers = [value for value in values if value is not None]
    return statistics.fmean(numbers) if numbers else None
