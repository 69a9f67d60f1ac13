"""The benchmark of denoisers: time per frame and memory, each in its own process, one frame each in turn.

A machine's speed drifts; as the denoisers alternate frame by frame, all of them meet the same drift and their ratios
are fair. As each has its own process, its peak memory is not mixed with that of another one.
"""

import multiprocessing
import statistics
import time
from collections.abc import Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np

from nte.denoiser import State, require_channels
from nte.errors import NteError
from nte.evaluation.benchmark.frames import source_of
from nte.evaluation.benchmark.steps import WARM_UP, named_steps
from nte.evaluation.metric_table import Row
from nte.frames.channels import reference_of
from nte.frames.clip import Clip
from nte.frames.frame import Array
from nte.frames.reference import usable_pixels
from nte.frames.scalars import sequence_scalars
from nte.memory import peak_resident_mb
from nte.progress import Progress
from nte.registry import load_denoiser

FORMAT = "nte-bench/1"


@dataclass(frozen=True)
class Task:
    """One denoiser at one size, on a clip's frames or on synthetic ones."""

    spec: str
    size: tuple[int, int]  # (height, width)
    clip: Path | None  # None: synthetic frames
    device: str


def bench(
    specs: Sequence[str],
    sizes: Sequence[tuple[int, int]] = (),
    frames: int = 10,
    clip: Path | None = None,
    device: str = "cpu",
    steps: bool = False,
) -> list[Row]:
    """Measure denoisers; return a row for each size and denoiser, with `ms_per_frame` (median), `p95` and `peak_mb`.

    sizes: (height, width) each; empty takes the clip's size, or 1280×720. frames: number of timed frames, after four
    others. clip: None for synthetic frames. steps: also measure the milliseconds of each named step of a denoiser
    (nte.evaluation.benchmark.steps), apart and including the profiler's own time. In a row, peak_mb is
    the peak of resident memory (10⁶ bytes) above that of the process with denoiser and first frame loaded, and psnr
    the mean over the timed frames, if the clip has the target's reference and its own size. Raises NteError for a
    denoiser that does not fit the frames, and if a process dies.
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
    """Measure denoisers that alternate frame by frame; return their rows."""
    workers: list[_Worker] = []
    try:
        # Loaded one after the other: loading is not measured, but two at once would take twice the memory.
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
        """Receive the process's next answer; its NteError is raised here."""
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
        """Let the process denoise a frame; keep the time unless the frame is one of the warm-up."""
        self.pipe.send(index)
        milliseconds, score = self.answer()
        if index >= WARM_UP:
            self.times.append(milliseconds)
            self.scores += [] if score is None else [score]

    def row(self, steps: bool) -> Row:
        """End the measurement and return the row of results."""
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
    """Run in the process: send None when ready, then answer a frame's index with (ms, PSNR or None)."""
    try:
        denoiser = load_denoiser(task.spec, task.device)
        reference = reference_of(denoiser.target)
        scored = task.clip is not None and task.size == _size_of(task.clip)
        channels = [*denoiser.needs, *denoiser.optional, *([reference] if scored else [])]
        source = source_of(task.clip, task.size, channels)
        first = source(0)
        require_channels(denoiser, first.channels, task.clip or "synthetic frames")
        exposure = sequence_scalars(first)[0] if scored and "color" in first else np.ones(1, np.float32)
        before = peak_resident_mb()
        del first  # later frames take its place: a frame's memory is not the denoiser's
        pipe.send(None)
        state: State | None = None
        while isinstance(index := pipe.recv(), int):
            frame = source(index)
            start = time.perf_counter()
            result, state = denoiser.step(frame, state)
            milliseconds = 1e3 * (time.perf_counter() - start)
            score = _psnr(result.image, frame[reference], exposure) if scored and reference in frame else None
            pipe.send((milliseconds, score))
        peak = peak_resident_mb() - before
        pipe.send((peak, named_steps(denoiser, source) if index == "steps" else {}))
        pipe.recv()  # until the other side closes
    except NteError as error:
        pipe.send(error)
    except EOFError:
        pass


def _psnr(image: Array, reference: Array, exposure: Array) -> float:
    """PSNR in decibels after the display transform, over the pixels with a usable reference."""
    import torch

    from nte.color import display, psnr

    shown = [display(torch.as_tensor(a), torch.as_tensor(exposure)) for a in (image, reference)]
    errors = (shown[0] - shown[1]).square().mean(1, keepdim=True)[usable_pixels(torch.as_tensor(reference))]
    return float(psnr(errors.mean()))
