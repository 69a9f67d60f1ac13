"""The cost of training: frames per second, seconds by stage, time spent waiting for data, memory."""

import time
from collections.abc import Callable

import torch

from nte.memory import MB, peak_resident_mb

STAGES = ("data", "forward", "backward", "optimiser")


class Meter:
    """A meter of throughput and of the time of each stage, since the last reading.

    frames: number of frames per step, of all processes. synchronise: waits for the device before each look at the
    clock; None: stages on a device that computes by itself overlap, and only their sum is right.
    """

    def __init__(self, frames: int, synchronise: Callable[[], None] | None = None) -> None:
        self.frames, self.synchronise = frames, synchronise
        self._reset()

    def _reset(self) -> None:
        self.steps, self.total = 0, 0.0
        self.seconds = dict.fromkeys(STAGES, 0.0)

    def begin(self) -> None:
        """Begin a step, before the loader is asked."""
        self._start = self._lap = self._now()

    def lap(self, stage: str) -> None:
        """Note that a stage, one of STAGES, has ended; it lasted since the one before."""
        now = self._now()
        self.seconds[stage] += now - self._lap
        self._lap = now

    def end(self) -> None:
        """End the step."""
        self.total += self._now() - self._start
        self.steps += 1

    def _now(self) -> float:
        if self.synchronise is not None:
            self.synchronise()
        return time.perf_counter()

    def read(self) -> dict[str, float]:
        """Return frames_per_second, seconds_per_step, loader_wait (share of a step) and peak_memory_mb; start anew.

        The peak (10⁶ bytes) is since the start of the process: allocated CUDA memory if there is CUDA, else resident.
        """
        peak = torch.cuda.max_memory_allocated() / MB if torch.cuda.is_available() else peak_resident_mb()
        values = {
            "frames_per_second": self.frames * self.steps / self.total,
            "seconds_per_step": self.total / self.steps,
            "loader_wait": self.seconds["data"] / self.total,
            "peak_memory_mb": peak,
        }
        self._reset()
        return values
