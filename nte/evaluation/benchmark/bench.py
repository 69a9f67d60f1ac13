"""How long denoisers take per frame, and how much memory: each in a process of its own, one frame each in turn.

A machine's speed drifts; as the denoisers alternate frame by frame, all of them meet the same drift and their
ratios are fair. In a process of its own a denoiser's peak of memory is not that of another one.
"""

import multiprocessing
import resource
import statistics
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from nte.denoiser import Denoiser, State, check_needs
from nte.errors import NteError
from nte.evaluation.benchmark.frames import Source, source_of
from nte.frames.channels import reference_of
from nte.frames.clip import Clip
from nte.frames.frame import Array
from nte.frames.reference import usable_pixels
from nte.frames.scalars import sequence_scalars
from nte.progress import Progress
from nte.registry import load_denoiser

FORMAT = "nte-bench/1"
WARM_UP = 4  # frames: caches fill, and history grows beyond what filters call young
Row = dict[str, Any]


@dataclass(frozen=True)
class Task:
    """One denoiser at one size, on a clip's frames or on synthetic ones."""

    spec: str
    size: tuple[int, int]  # (height, width)
    clip: Path | None
    device: str


def bench(
    specs: Sequence[str],
    sizes: Sequence[tuple[int, int]] = (),
    frames: int = 10,
    clip: Path | None = None,
    device: str = "cpu",
    steps: bool = False,
) -> list[Row]:
    """A row for each size (height, width) and denoiser: `ms_per_frame` (median), `p95`, `peak_mb`, …

    sizes: 1280×720, or that of the clip, unless given. frames: timed ones, after WARM_UP others. peak_mb: resident
    memory of the process above what it had with the first frame read, before the denoiser was loaded. psnr: mean over
    the timed frames, where the clip has the target's reference and its own size. steps: also the time of each
    named step (torch.profiler.record_function) of a denoiser, which is measured apart and includes the
    profiler's own. Raises NteError for what does not fit, and where a process dies.
    """
    if frames < 1:
        raise NteError(f"--frames is {frames}, expected at least 1")
    if not specs:
        raise NteError("nothing to measure: expected at least one denoiser")
    own = _size_of(clip) if clip else (720, 1280)
    rows = []
    for size in sizes or [own]:
        tasks = [Task(spec, size, clip, device) for spec in specs]
        rows += _together(tasks, frames, steps)
    return rows


def _size_of(clip: Path) -> tuple[int, int]:
    info = Clip(clip).info
    return int(info["height"]), int(info["width"])


def _together(tasks: Sequence[Task], frames: int, steps: bool) -> list[Row]:
    """The rows of denoisers that alternate frame by frame."""
    workers: list[_Worker] = []
    try:
        # One after the other: loading is no part of the measurement, but two at once would take twice the memory.
        for task in tasks:
            workers.append(_Worker(task))
            workers[-1].answer()
        with Progress(f"bench {tasks[0].size[1]}x{tasks[0].size[0]}", WARM_UP + frames, "frame") as progress:
            for index in range(WARM_UP + frames):
                for worker in workers:
                    worker.time(index)
                progress.advance(1)
        return [worker.row(steps) for worker in workers]
    finally:
        for worker in workers:
            worker.stop()


class _Worker:
    """A process with one denoiser, seen from outside."""

    def __init__(self, task: Task) -> None:
        context = multiprocessing.get_context("spawn")
        self.task = task
        self.pipe, theirs = context.Pipe()
        self.process = context.Process(target=_serve, args=(theirs, task), daemon=True)
        self.process.start()
        theirs.close()
        self.times: list[float] = []
        self.scores: list[float] = []

    def answer(self) -> Array:
        """What the process says next; its NteError is raised here."""
        try:
            answer = self.pipe.recv()
        except (EOFError, ConnectionResetError):
            self.process.join()
            code = self.process.exitcode
            raise NteError(f"'{self.task.spec}': its process ended with status {code}: out of memory?") from None
        if isinstance(answer, NteError):
            raise answer
        return answer

    def time(self, index: int) -> None:
        """Let it denoise a frame."""
        self.pipe.send(index)
        milliseconds, score = self.answer()
        if index >= WARM_UP:
            self.times.append(milliseconds)
            self.scores += [] if score is None else [score]

    def row(self, steps: bool) -> Row:
        """What has been measured."""
        self.pipe.send("steps" if steps else "end")
        peak, named = self.answer()
        height, width = self.task.size
        row = {"denoiser": self.task.spec, "width": width, "height": height, "frames": len(self.times)}
        row |= {"ms_per_frame": statistics.median(self.times), "p95": float(np.percentile(self.times, 95))}
        row |= {"peak_mb": peak}
        if self.scores:
            row["psnr"] = statistics.mean(self.scores)
        if steps:
            row["steps"] = named
        return row

    def stop(self) -> None:
        """End the process."""
        self.pipe.close()
        self.process.terminate()
        self.process.join()


def _serve(pipe: Connection, task: Task) -> None:
    """The process: says None when ready, then answers a frame's index with (ms, PSNR or None)."""
    try:
        denoiser = load_denoiser(task.spec, task.device)
        reference = reference_of(denoiser.target)
        scored = task.clip is not None and task.size == _size_of(task.clip)
        channels = [*denoiser.needs, *denoiser.optional, *([reference] if scored else [])]
        source = source_of(task.clip, task.size, channels)
        first = source(0)
        check_needs(denoiser, first.channels, task.clip or "synthetic frames")
        exposure = sequence_scalars(first)[0] if scored and "color" in first else np.ones(1, np.float32)
        before = _peak_mb()
        del first  # the frames to come take its place: a frame is no memory of the denoiser's
        pipe.send(None)
        state: State | None = None
        while isinstance(index := pipe.recv(), int):
            frame = source(index)
            start = time.perf_counter()
            result, state = denoiser.step(frame, state)
            milliseconds = 1e3 * (time.perf_counter() - start)
            score = _psnr(result.image, frame[reference], exposure) if scored and reference in frame else None
            pipe.send((milliseconds, score))
        peak = _peak_mb() - before
        pipe.send((peak, named_steps(denoiser, source) if index == "steps" else {}))
        pipe.recv()  # until the other side closes
    except NteError as error:
        pipe.send(error)
    except EOFError:
        pass


def _peak_mb() -> float:
    """The most that this process has had resident so far, in MB (10⁶ bytes)."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / 1e6 if sys.platform == "darwin" else peak * 1024 / 1e6


def _psnr(image: Array, reference: Array, exposure: Array) -> float:
    """PSNR in decibels after the display transform, of the pixels whose reference says something."""
    import torch

    from nte.color import display, psnr

    shown = [display(torch.as_tensor(a), torch.as_tensor(exposure)) for a in (image, reference)]
    errors = (shown[0] - shown[1]).square().mean(1, keepdim=True)[usable_pixels(torch.as_tensor(reference))]
    return float(psnr(errors.mean()))


def named_steps(denoiser: Denoiser, source: Source, frames: int = 2) -> dict[str, float]:
    """Milliseconds per frame in each named step of a denoiser, in the order in which they first begin."""
    from torch.profiler import ProfilerActivity, profile

    state: State | None = None
    for index in range(WARM_UP):
        _, state = denoiser.step(source(index), state)
    spent: dict[str, float] = {}
    for index in range(WARM_UP, WARM_UP + frames):
        frame = source(index)
        with profile(activities=[ProfilerActivity.CPU]) as profiler:
            _, state = denoiser.step(frame, state)
        for event in sorted(profiler.events(), key=lambda event: event.time_range.start):
            if event.is_user_annotation:
                spent[event.name] = spent.get(event.name, 0.0) + event.time_range.elapsed_us() / 1e3 / frames
    return spent
