"""Comparing denoisers over clips: what `nte evaluate` does, up to metrics.json."""

import json
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from nte.denoiser import Denoiser, check_needs
from nte.errors import NteError
from nte.evaluation.metric_table import METRICS
from nte.evaluation.score_clip import ClipRun, Shown, mean
from nte.evaluation.targets import reference_of
from nte.files import only_writer, write_whole
from nte.frames.clip import Clip, find_clips
from nte.registry import load_denoiser

FORMAT = "nte-metrics/1"
OURS = ("metrics.json", "index.html")  # all that an evaluation writes, and so all that force replaces
Progress = Callable[[int, int, str], None]  # frames done, frames in all, clip and frame


@dataclass(frozen=True)
class Evaluation:
    """The content of metrics.json, and one frame of each clip and target for the report."""

    metrics: dict[str, Any]
    shown: list[Shown]

    def titled(self, titles: Mapping[str, str]) -> "Evaluation":
        """The same, with denoisers called by titles (spec → title) for people to read."""

        def rename(images: Mapping[str, Any]) -> dict[str, Any]:
            return {titles.get(name, name): image for name, image in images.items()}

        rows = [{**row, "denoiser": titles[row["denoiser"]]} for row in self.metrics["rows"]]
        metrics = {**self.metrics, "rows": rows, "means": rename(self.metrics["means"])}
        return Evaluation(metrics, [replace(s, images=rename(s.images), flip=rename(s.flip)) for s in self.shown])


def evaluate(
    clips: Iterable[Path],
    specs: Iterable[str],
    out: Path,
    first: int = 1,
    lights: Sequence[str] | None = None,
    force: bool = False,
    device: str = "cpu",
    progress: Progress | None = None,
) -> Evaluation:
    """Run every denoiser over every clip, score its frames, and write `out`/metrics.json.

    clips: clip folders, or folders that hold clips. first: index of the first frame that is scored; every denoiser
    starts at frame 0. lights: the light components that are scored besides each denoiser's own target; None takes
    all that it gives. One frame of one clip is in memory at a time, beside the denoisers' states. Raises NteError,
    before any work is done, for what is missing and for an `out` that exists without `force`.
    """
    folders = find_clips(clips)
    opened = dict(zip(clip_labels(folders), map(Clip, folders), strict=True))
    denoisers = {spec: load_denoiser(spec, device) for spec in dict.fromkeys(specs)}
    if not denoisers:
        raise NteError("no denoisers to evaluate: name at least one, for example noisy")
    for label, clip in opened.items():
        _check(label, clip, denoisers, first)
    prepare_folder(out, force)
    with only_writer(out):
        return _evaluated(opened, denoisers, out, first, lights, device, progress)


def _evaluated(
    opened: Mapping[str, Clip], denoisers: Mapping[str, Denoiser], out: Path, first: int,
    lights: Sequence[str] | None, device: str, progress: Progress | None,
) -> Evaluation:  # fmt: skip
    """Run, score and write, of what `evaluate` has checked."""
    total, done = sum(map(len, opened.values())), 0
    rows: list[dict[str, Any]] = []
    shown: list[Shown] = []
    for label, clip in opened.items():
        run = ClipRun(label, clip, denoisers, device, first, lights)
        for index in range(len(clip)):
            run.advance(index)
            done += 1
            if progress:
                progress(done, total, f"{label}, frame {index}")
        rows += run.rows()
        shown += run.shown.values()
    metrics = {"format": FORMAT, "rows": rows, "means": means_of(rows)}
    text = json.dumps(metrics, indent=1, allow_nan=False) + "\n"
    write_whole(out / "metrics.json", lambda temporary: temporary.write_text(text, encoding="utf-8") and None)
    return Evaluation(metrics, shown)


def clip_labels(folders: Sequence[Path]) -> list[str]:
    """A short unique name for each clip: the folder's, with its parents where several have the same."""
    resolved = [folder.resolve() for folder in folders]
    names = [folder.name for folder in resolved]
    common = Path(os.path.commonpath([folder.parent for folder in resolved])) if resolved else Path()
    return [
        folder.relative_to(common).as_posix() if names.count(folder.name) > 1 else folder.name for folder in resolved
    ]


def prepare_folder(out: Path, force: bool) -> None:
    """Make the folder that results go to. Raises NteError if it holds something already, unless `force`."""
    if out.exists() and not out.is_dir():
        raise NteError(f"{out}: is a file: expected a folder for the results")
    if not force and out.is_dir() and any(out.iterdir()):
        raise NteError(f"{out}: exists: choose another folder, or --force to replace its {' and '.join(OURS)}")
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise NteError(f"{out}: cannot be made: {error.strerror}") from error


def means_of(
    rows: Sequence[Mapping[str, Any]], region: str = "all", target: str | None = None
) -> dict[str, dict[str, float | None]]:
    """Spec → metric → mean over the clips that have a number, of the rows of a region.

    target: the light that is scored; None takes what each denoiser gives as its image.
    """
    own: dict[str, str] = {}  # a denoiser's own target stands in its first row
    for row in rows:
        own.setdefault(row["denoiser"], row["target"])
    by_spec: dict[str, list[Mapping[str, Any]]] = {}
    for row in rows:
        if row["region"] == region and row["target"] == (target or own[row["denoiser"]]):
            by_spec.setdefault(row["denoiser"], []).append(row)
    return {spec: {m.name: mean(row[m.name] for row in chosen) for m in METRICS} for spec, chosen in by_spec.items()}


def _check(label: str, clip: Clip, denoisers: Mapping[str, Denoiser], first: int) -> None:
    """Raise NteError for a clip that cannot be evaluated: better now than after an hour."""
    if len(clip) == first == 1:
        raise NteError(f"{clip.folder}: has one frame, and the first frame is not scored: use --first-frame")
    if len(clip) <= first:
        raise NteError(f"{clip.folder}: has {len(clip)} frames, and frame {first} is the first that is scored")
    for spec, denoiser in denoisers.items():
        check_needs(denoiser, clip.channels, f"{label}: {spec}")
        name = reference_of(denoiser.target)
        if name not in clip.channels:
            have = ", ".join(clip.channels)
            raise NteError(f"{clip.folder}: no channel '{name}' to compare {spec} with; it has {have}")
