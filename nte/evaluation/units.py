"""The evaluation of a clip as a unit of work, for `nte.jobs`."""

import os
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache, lru_cache
from pathlib import Path
from typing import TypeAlias

import torch

from nte.cluster import on_cluster
from nte.denoiser import Denoiser, require_channels
from nte.errors import NteError
from nte.evaluation.metric_table import Row
from nte.evaluation.score_clip import ClipRun, Shown
from nte.filters.threads import limit_threads
from nte.frames.channels import reference_of
from nte.frames.clip import Clip
from nte.jobs import Kind, in_processes, require_jobs, tick
from nte.registry import load_denoiser, parts_of
from nte.version import DENOISING, versions_of
from nte.viewer.recorder import Recording, recorder_of

Stamp: TypeAlias = tuple[Path, int, int]  # a file, its time of modification in ns, and its size in bytes


@dataclass(frozen=True)
class ClipUnit:
    """The evaluation of denoisers on one clip, and all that it depends on."""

    label: str  # the clip's name in rows
    clip: Path
    denoisers: tuple[str, ...]  # specifications
    first: int  # index of the first frame that is scored
    lights: tuple[str, ...] | None  # light components that are scored; None: all that a denoiser gives
    device: str
    pictured: tuple[str, ...] | None = None  # denoisers that the report shows; None: all
    recording: Recording | None = None  # what of the clip the viewer shows; None: nothing


@dataclass(frozen=True)
class ClipScores:
    """The result of one clip: rows of metrics.json, pictures, and the denoisers that failed, with the reason.

    Without rows and pictures if the clip itself cannot be scored: `fault` says why.
    """

    rows: list[Row]
    shown: list[Shown]
    failed: dict[str, str] = field(default_factory=dict)
    told: list[Warning] = field(default_factory=list)  # warnings of another process
    recorded: Row | None = None  # what the viewer has of the clip: `Recorder.entry`
    fault: str = ""


def score_clip(
    unit: ClipUnit,
    denoisers: Mapping[str, Denoiser],
    tick: Callable[[int], None] = lambda index: None,
    strict: bool = True,
) -> ClipScores:
    """Run denoisers over a clip, and score their frames; call tick(index) after each frame.

    strict: raise NteError as soon as a denoiser fails; otherwise the others go on.
    """
    clip = Clip(unit.clip)
    recorder = recorder_of(unit.recording, unit.label, clip) if unit.recording else None
    run = ClipRun(unit.label, clip, denoisers, unit.device, unit.first, unit.lights, recorder)
    for index in range(len(clip)):
        run.advance(index)
        if strict and run.failed:
            raise NteError(next(iter(run.failed.values())))
        tick(index)
    shown = [one if unit.pictured is None else one.only(unit.pictured) for one in run.shown.values()]
    if recorder:
        recorder.end()
    entry = recorder.entry() if recorder else None
    return ClipScores(run.rows(), [one for one in shown if one.flip], run.failed, recorded=entry)


def evaluate_clip(unit: ClipUnit, tick: Callable[[int], None] = lambda index: None) -> ClipScores:
    """Load the denoisers of a unit and score them; one that fails, also in loading, is told in `failed`.

    A clip that cannot be read or scored is told in `fault`.
    """
    failed: dict[str, str] = {}
    loaded: dict[str, Denoiser] = {}
    try:
        clip = Clip(unit.clip)
    except NteError as error:
        return ClipScores([], [], fault=str(error))
    for spec in unit.denoisers:
        try:
            denoiser = _load(spec, unit.device)
            require_scorable(unit.label, clip, {spec: denoiser}, unit.first)
            loaded[spec] = denoiser
        except NteError as error:
            failed[spec] = str(error)
    try:
        scores = score_clip(unit, loaded, tick, strict=False)
    except NteError as error:  # a damaged frame, or a reference that cannot be scored: no denoiser can help it
        return ClipScores([], [], fault=str(error))
    return replace(scores, failed=failed | scores.failed)


def require_scorable(label: str, clip: Clip, denoisers: Mapping[str, Denoiser], first: int) -> None:
    """Raise NteError for a clip that cannot be evaluated, before an hour of work is lost."""
    if len(clip) == first == 1:
        raise NteError(f"{clip.folder}: has one frame, and the first frame is not scored: use --first-frame")
    if len(clip) <= first:
        raise NteError(f"{clip.folder}: has {len(clip)} frames, and frame {first} is the first that is scored")
    if "color" not in clip.channels and "exposure" not in clip.info:
        have = ", ".join(clip.channels)
        raise NteError(
            f"{clip.folder}: no channel 'color' to measure the exposure of, in which scores are taken; it has {have}: "
            "set 'exposure' in its clip.json"
        )
    for spec, denoiser in denoisers.items():
        require_channels(denoiser, clip.channels, f"{label}: {spec}")
        name = reference_of(denoiser.target)
        if name not in clip.channels:
            have = ", ".join(clip.channels)
            raise NteError(f"{clip.folder}: no channel '{name}' to compare {spec} with; it has {have}")


def files_of(spec: str) -> list[Path]:
    """Find the files that a denoiser is read from: an exported model, or a checkpoint with its run's config.yaml."""
    files = []
    for path in map(Path, parts_of(spec)):
        file = path / "checkpoint.safetensors" if path.is_dir() else path
        files += [file.with_name("config.yaml"), file] if file.suffix == ".safetensors" else [file]
    return [file for file in files if file.is_file()]


def stamps_of(spec: str) -> tuple[Stamp, ...]:
    """Return the files that a denoiser is read from, each with its time and size, which tell if it has changed."""
    return tuple((file, file.stat().st_mtime_ns, file.stat().st_size) for file in files_of(spec))


def _load(spec: str, device: str) -> Denoiser:
    """Load a denoiser once for many clips, and again if its files have changed.

    An exported model gets as many threads as PyTorch has, of which a machine may have fewer cores.
    """
    threads = min(torch.get_num_threads(), os.cpu_count() or 1)
    return _loaded(spec, device, threads, stamps_of(spec))


@lru_cache(maxsize=128)
def _loaded(spec: str, device: str, threads: int, stamps: tuple[Stamp, ...]) -> Denoiser:
    return load_denoiser(spec, device, threads)


def elsewhere(
    units: Mapping[str, ClipUnit],
    folder: Path,
    jobs: int,
    scheduler: str | None,
    done: Callable[[str, ClipScores], None],
    advance: Callable[[int], None],
) -> None:
    """Evaluate units in processes, or on the workers of a Dask scheduler that see `folder`; call done(name, scores).

    advance: called with the number of frames that were done, as they are; on a cluster, with those of each whole clip.
    """
    require_jobs(jobs)

    def tell(name: str, scores: ClipScores) -> None:
        for message in scores.told:
            warnings.warn(message, stacklevel=2)
        done(name, scores)

    def whole(name: str, scores: ClipScores) -> None:
        advance(len(Clip(units[name].clip)))
        tell(name, scores)

    if scheduler is not None:
        on_cluster(EVALUATION, _there, units, folder, scheduler, whole)
    else:
        in_processes(EVALUATION, _there, units, jobs, tell, advance)


def _there(unit: ClipUnit) -> ClipScores:
    """Evaluate a clip in another process, which hands its warnings on."""
    with warnings.catch_warnings(record=True) as told:
        scores = evaluate_clip(unit, lambda index: tick())
    return replace(scores, told=[warning.message for warning in told if isinstance(warning.message, Warning)])


def share_threads(jobs: int) -> None:
    """Limit denoisers to this process's share of the cores, for `jobs` processes side by side."""
    limit_threads(max(1, _threads() // jobs))


@cache  # the number that the process started with
def _threads() -> int:
    return torch.get_num_threads()


def _versions() -> dict[str, str]:
    return versions_of(*DENOISING, "torchmetrics", "flip-evaluator")


EVALUATION = Kind("evaluate", share_threads, _versions)
