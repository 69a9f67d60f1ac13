"""A process with one denoiser, which denoises a frame when it is told to and says how long that took."""

import copy
import multiprocessing
import statistics
import time
from collections.abc import Mapping
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from nte.denoiser import Denoiser, State, require_channels
from nte.errors import NteError, lacking_memory
from nte.evaluation.benchmark.frames import source_of
from nte.evaluation.benchmark.results import Measured
from nte.evaluation.benchmark.steps import WARM_UP, named_steps
from nte.filters.prior import OnTop
from nte.filters.threads import limit_threads
from nte.frames.clip import Clip, Pixels
from nte.machine import device_or_cpu, wait_for
from nte.memory import peak_resident_mb
from nte.models.cost import macs_per_pixel
from nte.models.trainable import TrainableDenoiser
from nte.registry import load_denoiser
from nte.runtime.session import OnnxDenoiser

if TYPE_CHECKING:
    from nte.evaluation.benchmark.quality import Judge, Quality


@dataclass(frozen=True)
class Task:
    """One denoiser at one size on some CPU threads, on a clip's frames or on synthetic ones."""

    spec: str
    size: tuple[int, int]  # (height, width)
    threads: int
    clip: Path | None  # None: synthetic frames
    device: str


class _Loaded(NamedTuple):
    """What the process says once its denoiser is there."""

    target: str
    start_ms: float
    macs: Mapping[str, float]


class Worker:
    """The process of a task, seen from outside. Every method raises the NteError that the process met with."""

    def __init__(self, task: Task) -> None:
        context = multiprocessing.get_context("spawn")
        self.task = task
        self.pipe, theirs = context.Pipe()
        self.process = context.Process(target=_serve, args=(theirs, task), daemon=True)
        self.process.start()
        theirs.close()
        self.times: list[float] = []
        self.scores: list[Quality] = []
        self.judge: Judge | None = None

    def load(self) -> None:
        """Wait until the denoiser is loaded, and find out whether its images can be judged."""
        from nte.evaluation.benchmark.quality import Judge  # not in the process, whose start it would make slower

        self.loaded: _Loaded = self._answer()
        clip = self.task.clip
        if clip is not None and self.task.size == size_of(clip):
            judge = Judge(clip, self.loaded.target)
            self.judge = judge if judge.scores else None

    def denoise(self, index: int) -> None:
        """Let the process denoise a frame; keep its time, and its quality unless it belongs to the warm-up."""
        judge = self.judge if index >= WARM_UP else None
        self.pipe.send((index, judge is not None))
        milliseconds, shape = self._answer()
        self.times.append(milliseconds)
        if judge is not None:
            image: Pixels = np.frombuffer(self.pipe.recv_bytes(), np.float32).reshape(shape).copy()
            self.scores.append(judge.score(index, image, self.task.spec))

    def measured(self, steps: bool) -> Measured:
        """End the measurement and return its results. steps: measure the time in each step before."""
        self.pipe.send("steps" if steps else "end")
        peak, named = self._answer()
        height, width = self.task.size
        timed = self.times[WARM_UP:]
        return Measured(
            denoiser=self.task.spec,
            width=width,
            height=height,
            threads=self.task.threads,
            frames=len(timed),
            start_ms=self.loaded.start_ms,
            first_ms=self.times[0],
            ms_per_frame=statistics.median(timed),
            p95=float(np.percentile(timed, 95)),
            peak_mb=peak,
            macs=self.loaded.macs,
            psnr=_mean([score.psnr for score in self.scores]),
            flip=_mean([score.flip for score in self.scores]),
            steps=named,
        )

    def stop(self) -> None:
        """End the process."""
        self.pipe.close()
        self.process.terminate()
        self.process.join()

    def _answer(self) -> Any:
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


def size_of(clip: Path) -> tuple[int, int]:
    """Return the size (height, width) of a clip."""
    info = Clip(clip).info
    return int(info["height"]), int(info["width"])


def macs_of(denoiser: Denoiser) -> dict[str, float]:
    """Return the multiply-accumulates per pixel of each step of a network; nothing for any other denoiser.

    Those of an exported model are in its description. What a filter below a network does is not counted.
    """
    if isinstance(denoiser, OnTop):
        return macs_of(denoiser.top)
    if isinstance(denoiser, TrainableDenoiser):
        on_cpu = copy.deepcopy(denoiser).cpu()
        return {step: sum(counts) for step, counts in macs_per_pixel(on_cpu).items()}
    return dict(denoiser.info.get("macs", {})) if isinstance(denoiser, OnnxDenoiser) else {}


def _serve(pipe: Connection, task: Task) -> None:
    """Run in the process: send _Loaded when ready, then answer (index, wanted) with its time and, if wanted, image."""
    try:
        limit_threads(task.threads)
        begin = time.perf_counter()
        denoiser = load_denoiser(task.spec, task.device, task.threads)
        start_ms = 1e3 * (time.perf_counter() - begin)
        source = source_of(task.clip, task.size, [*denoiser.needs, *denoiser.optional])
        first = source(0)
        require_channels(denoiser, first.channels, task.clip or "synthetic frames")
        macs = macs_of(denoiser)
        before = peak_resident_mb()
        del first  # later frames take its place: a frame's memory is not the denoiser's
        pipe.send(_Loaded(denoiser.target, start_ms, macs))
        device = device_or_cpu(task.device)
        state: State | None = None
        while not isinstance(message := pipe.recv(), str):
            index, wanted = message
            frame = source(index)
            begin = time.perf_counter()
            result, state = denoiser.step(frame, state)
            wait_for(device)
            image: Pixels = np.asarray(result.image, np.float32, order="C")
            pipe.send((1e3 * (time.perf_counter() - begin), image.shape))
            if wanted:
                pipe.send_bytes(image.data)
        peak = peak_resident_mb() - before
        pipe.send((peak, named_steps(denoiser, source, device=device) if message == "steps" else {}))
        pipe.recv()  # until the other side closes
    except NteError as error:
        pipe.send(error)
    except EOFError:
        pass
    except Exception as error:
        if (what := lacking_memory(error)) is None:
            raise
        height, width = task.size
        pipe.send(NteError(f"'{task.spec}' at {width}x{height}: {what}"))


def _mean(values: list[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return statistics.fmean(known) if known else None
