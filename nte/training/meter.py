"""The cost of training: frames per second, time spent waiting for data, memory."""

import time

import torch

from nte.memory import MB, peak_resident_mb


class Meter:
    """A meter of throughput and of the share of time spent waiting for data, since the last reading.

    frames: number of frames per step, of all processes.
    """

    def __init__(self, frames: int) -> None:
        self.frames = frames
        self._reset()

    def _reset(self) -> None:
        self.steps, self.waited, self.total = 0, 0.0, 0.0

    def begin(self) -> None:
        """Begin a step, before the loader is asked."""
        self._start = time.perf_counter()

    def loaded(self) -> None:
        """Note that the loader has answered."""
        self.waited += time.perf_counter() - self._start

    def end(self) -> None:
        """End the step."""
        self.total += time.perf_counter() - self._start
        self.steps += 1

    def read(self) -> dict[str, float]:
        """Return frames_per_second, seconds_per_step, loader_wait (share of a step) and peak_memory_mb; start anew.

        The peak (10⁶ bytes) is since the start of the process: allocated CUDA memory if there is CUDA, else resident.
        """
        peak = torch.cuda.max_memory_allocated() / MB if torch.cuda.is_available() else peak_resident_mb()
        values = {
            "frames_per_second": self.frames * self.steps / self.total,
            "seconds_per_step": self.total / self.steps,
            "loader_wait": self.waited / self.total,
            "peak_memory_mb": peak,
        }
        self._reset()
        return values
