"""The benchmark of denoisers: time per frame and memory, each in its own process, one frame each in turn.

A machine's speed drifts; as the denoisers alternate frame by frame, all of them meet the same drift and their ratios
are fair. As each has its own process, its peak memory is not mixed with that of another one.
"""

import os
from collections.abc import Sequence
from pathlib import Path

import torch

from nte.errors import NteError
from nte.evaluation.benchmark.results import Measured, Results
from nte.evaluation.benchmark.steps import WARM_UP
from nte.evaluation.benchmark.worker import Task, Worker, size_of
from nte.machine import device_or_cpu, measure_speed
from nte.progress import Progress


def bench(
    specs: Sequence[str],
    sizes: Sequence[tuple[int, int]] = (),
    frames: int = 10,
    clip: Path | None = None,
    device: str = "cpu",
    steps: bool = False,
    threads: Sequence[int] = (),
) -> Results:
    """Measure denoisers, and the speed of the machine; return a row for each size, number of threads and denoiser.

    sizes: (height, width) each; empty takes the clip's size, or 1280×720. frames: number of timed frames, after four
    others. clip: None for synthetic frames; frames that are timed are compared with its reference, if the size is its
    own. steps: also measure the milliseconds of each named step of a denoiser (nte.evaluation.benchmark.steps), apart.
    threads: numbers of CPU threads, each of which every denoiser is measured on; empty takes as many as PyTorch does.
    Raises NteError for a denoiser that does not fit the frames, and if a process dies.
    """
    if frames < 1:
        raise NteError(f"--frames is {frames}, expected at least 1")
    if not specs:
        raise NteError("nothing to measure: expected at least one denoiser")
    threads = list(dict.fromkeys(threads)) or [torch.get_num_threads()]
    require_threads(threads)
    own = size_of(clip) if clip else (720, 1280)
    rows: list[Measured] = []
    for size in sizes or [own]:
        tasks = [Task(spec, size, count, clip, device) for count in threads for spec in specs]
        rows += _together(tasks, frames, steps)
    return Results(rows, {count: measure_speed(device_or_cpu(device), count) for count in threads})


def require_threads(threads: Sequence[int]) -> None:
    """Raise NteError for a number of threads that is not between 1 and the number of this machine's cores."""
    cores = os.cpu_count() or 1
    if wrong := [count for count in threads if not 1 <= count <= cores]:
        raise NteError(f"--threads is {wrong[0]}, expected 1 to {cores}, as this machine has {cores} cores")


def require_quality(clip: Path | None, sizes: Sequence[tuple[int, int]]) -> None:
    """Raise NteError unless denoisers can be compared with the reference of a clip in one of the sizes."""
    from nte.frames.clip import Clip

    if clip is None:
        raise NteError("--plot needs --clip: there is no quality without a reference")
    height, width = size_of(clip)
    if sizes and (height, width) not in sizes:
        raise NteError(f"--plot needs the size of the clip, {width}x{height}: there is no quality at another --size")
    if not any(name.startswith("reference") for name in Clip(clip).channels):
        raise NteError(f"--plot: {clip} has no reference, which quality is measured against")


def _together(tasks: Sequence[Task], frames: int, steps: bool) -> list[Measured]:
    """Measure denoisers that alternate frame by frame; return their rows."""
    workers: list[Worker] = []
    try:
        # Loaded one after the other: loading two at once would take twice the memory, and longer.
        for task in tasks:
            workers.append(Worker(task))
            workers[-1].load()
        with Progress(f"bench {tasks[0].size[1]}x{tasks[0].size[0]}", WARM_UP + frames, "frame") as progress:
            for index in range(WARM_UP + frames):
                for worker in workers:
                    worker.denoise(index)
                progress.advance(1)
        return [worker.measured(steps) for worker in workers]
    finally:
        for worker in workers:
            worker.stop()
