"""One clip, frame by frame: every denoiser beside the reference, its scores and its times."""

import statistics
import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import torch
from torch import Tensor

from nte.color import display
from nte.denoiser import Denoiser, Result, Session, State
from nte.errors import NteError
from nte.evaluation.metrics import REGIONS, Scores, region_mean, regions_of, score, temporal_l1, temporal_l1_floor
from nte.evaluation.table import METRICS
from nte.frames.channels import CHANNELS
from nte.frames.clip import Clip
from nte.frames.frame import Frame
from nte.frames.scalars import sequence_scalars
from nte.frames.show import RGB, heat, quantise

SCORED = tuple(metric.name for metric in METRICS if metric.name != "ms_per_frame")


@dataclass(frozen=True)
class Shown:
    """One frame of a clip for the report: the input, the references, every output and its FLIP error map."""

    clip: str
    frame: int
    disoccluded: int  # pixels
    images: dict[str, RGB] = field(default_factory=dict)  # noisy input, reference, then a spec each
    flip: dict[str, RGB] = field(default_factory=dict)  # a spec each


class Truth(NamedTuple):
    """What a target should look like, after the display transform, and its two independent halves if stored."""

    image: Tensor  # (1, 3, H, W)
    halves: tuple[Tensor, Tensor] | None


def reference_of(target: str) -> str:
    """The channel that a denoiser's output is compared with: the reference of its target."""
    return "reference" if target == "color" else f"reference_{target}"


class ClipRun:
    """Denoisers (spec → denoiser) over one clip: `advance` through the frames in order, then `rows` and `shown`.

    Raises NteError, naming denoiser, clip and frame, for an output or a reference that cannot be scored.
    """

    def __init__(
        self, label: str, clip: Clip, denoisers: Mapping[str, Denoiser], first_frame: bool, device: str
    ) -> None:
        self.label, self.clip, self.first_frame, self.device = label, clip, first_frame, device
        self.exposure = torch.from_numpy(sequence_scalars(clip.frame(0))[0])
        self.runs = [_Run(spec, denoiser, device) for spec, denoiser in denoisers.items()]
        self.truths: dict[str, Truth] = {}
        self.shown = Shown(label, -1, -1)
        self._depth: Tensor | None = None  # of the frame before

    @torch.no_grad()
    def advance(self, index: int) -> None:
        """Read a frame, let every denoiser step, and score what it gives."""
        frame = self.clip.frame(index).torch()
        on_device = frame.torch(self.device)
        before, self.truths = self.truths, {t: self._truth(frame, t) for t in self._targets()}
        regions = regions_of(frame, self._depth)
        self._depth = frame.get("depth")
        scored = index > 0 or self.first_frame
        # Denoisers differ most where most came into sight; the last of equals has the longest history.
        # So the data chooses the frame that is shown, not the results.
        disoccluded = int(regions["disoccluded"].sum()) if "disoccluded" in regions else 0
        chosen = scored and disoccluded >= self.shown.disoccluded
        if chosen:
            self.shown = Shown(self.label, index, disoccluded, self._given(frame))
        for run in self.runs:
            target = run.denoiser.target
            output = run.session.step(run.visible(on_device)).image.cpu()
            where = f"{run.spec} on {self.label}, frame {index}"
            image = self._display(output, target, where, tuple(self.truths[target].image.shape[2:]))
            if scored:
                maps = run.score(image, self.truths[target], before.get(target), regions)
                if chosen:
                    self.shown.images[run.spec] = _picture(image)
                    self.shown.flip[run.spec] = quantise(heat(maps["flip"][0, 0].numpy(), "magma"))
            run.before = image

    def rows(self) -> list[dict[str, Any]]:
        """The rows of metrics.json, one per denoiser and region."""
        return [
            {
                "denoiser": run.spec,
                "clip": self.label,
                "target": run.denoiser.target,
                "region": region,
                "first_frame": self.first_frame,
                **run.summary(region),
            }
            for run in self.runs
            for region in REGIONS
        ]

    def _targets(self) -> dict[str, None]:
        return dict.fromkeys(run.denoiser.target for run in self.runs)

    def _truth(self, frame: Frame, target: str) -> Truth:
        name = reference_of(target)
        where = f"'{name}' of {self.label}, frame {frame.index}"
        halves = [frame[half] for half in (f"{name}_a", f"{name}_b") if half in frame]
        shown = [self._display(image, target, where, frame.size) for image in (frame[name], *halves)]
        return Truth(shown[0], (shown[1], shown[2]) if len(halves) == 2 else None)

    def _display(self, image: Tensor, target: str, where: str, size: tuple[int, ...]) -> Tensor:
        """(1, 3, H, W) in [0, 1]: radiance through the display transform, other quantities as they are."""
        if tuple(image.shape[2:]) != size:
            raise NteError(f"{where}: the image is {tuple(image.shape)}, expected (1, C, {size[0]}, {size[1]})")
        if bad := int((~image.isfinite()).any(1).sum()):
            raise NteError(f"{where}: {bad} of {image[0, 0].numel()} pixels are not finite: it cannot be scored")
        if CHANNELS[target].shown == "radiance":
            return display(image, self.exposure)
        return image.clamp(0, 1).expand(-1, 3, -1, -1)

    def _given(self, frame: Frame) -> dict[str, RGB]:
        """Noisy input and reference of each target; no input where a denoiser `noisy` shows it already."""
        images = {}
        for target, truth in self.truths.items():
            suffix = f" ({target})" if len(self.truths) > 1 else ""
            if target in frame and "noisy" not in [run.spec for run in self.runs]:
                usable = torch.nan_to_num(frame[target], 0, 0, 0)
                images[f"noisy input{suffix}"] = _picture(self._display(usable, target, "", frame.size))
            images[f"reference{suffix}"] = _picture(truth.image)
        return images


class _Run:
    """One denoiser on one clip: its session, its output before, and its scores so far."""

    def __init__(self, spec: str, denoiser: Denoiser, device: str) -> None:
        self.spec, self.denoiser = spec, denoiser
        self.timed = _Timed(denoiser, device)
        self.session = Session(self.timed)
        self.before: Tensor | None = None
        self.scores: list[Scores] = []

    def visible(self, frame: Frame) -> Frame:
        """The frame with what the denoiser asks for and nothing else: above all without the reference."""
        wanted = (*self.denoiser.needs, *self.denoiser.optional)
        return replace(frame, channels={name: frame[name] for name in wanted if name in frame})

    def score(
        self, image: Tensor, truth: Truth, before: Truth | None, regions: Mapping[str, Tensor]
    ) -> dict[str, Tensor]:
        """Add the scores of one frame; gives its error maps."""
        scores, maps = score(image, truth.image, regions)
        if before and self.before is not None:
            maps["temporal_l1"] = temporal_l1(image, self.before, truth.image, before.image)
            if truth.halves and before.halves:
                (a, b), (a_before, b_before) = truth.halves, before.halves
                maps["temporal_l1_floor"] = temporal_l1_floor(a, a_before, b, b_before)
        for name in ("temporal_l1", "temporal_l1_floor"):
            for region, values in scores.items():
                values[name] = region_mean(maps[name], regions[region]) if name in maps else None
        self.scores.append(scores)
        return maps

    def summary(self, region: str) -> dict[str, Any]:
        """What a row of metrics.json says of a region: means over the frames that have any of its pixels."""
        per_frame = {name: [scores.get(region, {}).get(name) for scores in self.scores] for name in SCORED}
        return {
            "frames": sum(value is not None for value in per_frame["psnr"]),
            **{name: mean(values) for name, values in per_frame.items()},
            "ms_per_frame": 1000 * statistics.median(self.timed.seconds[1:] or self.timed.seconds),
            "per_frame": per_frame,
        }


class _Timed:
    """A denoiser with a stop-watch around its step, without what surrounds it."""

    def __init__(self, denoiser: Denoiser, device: str) -> None:
        self.denoiser = denoiser
        self.needs, self.optional, self.target = denoiser.needs, denoiser.optional, denoiser.target
        self.on_cpu = torch.device(device).type == "cpu"
        self.seconds: list[float] = []

    def step(self, frame: Frame, state: State | None, extras: tuple[str, ...] = ()) -> tuple[Result, State]:
        self._wait()
        start = time.perf_counter()
        result = self.denoiser.step(frame, state, extras)
        self._wait()
        self.seconds.append(time.perf_counter() - start)
        return result

    def _wait(self) -> None:
        if not self.on_cpu:
            torch.accelerator.synchronize()


def mean(values: Iterable[float | None]) -> float | None:
    """The mean of the numbers there are; None if there is none."""
    numbers = [value for value in values if value is not None]
    return statistics.fmean(numbers) if numbers else None


def _picture(image: Tensor) -> RGB:
    return quantise(image[0].numpy())
