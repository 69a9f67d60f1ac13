"""What training costs: frames a second, waiting for data, memory."""

import resource
import time

import torch


class Meter:
    """Throughput, share of time spent waiting for data, and peak memory since the last reading."""

    def __init__(self, frames: int) -> None:
        self.frames = frames
        self._reset()

    def _reset(self) -> None:
        self.steps, self.waited, self.total = 0, 0.0, 0.0

    def begin(self) -> None:
        """A step begins: the loader is asked."""
        self._start = time.perf_counter()

    def loaded(self) -> None:
        """The loader has answered."""
        self.waited += time.perf_counter() - self._start

    def end(self) -> None:
        """The step is done."""
        self.total += time.perf_counter() - self._start
        self.steps += 1

    def read(self) -> dict[str, float]:
        """frames_per_second, seconds_per_step, loader_wait (share of a step), peak_memory_mb; starts anew."""
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        if torch.cuda.is_available():
            peak = torch.cuda.max_memory_allocated() / 2**20
        values = {
            "frames_per_second": self.frames * self.steps / self.total,
            "seconds_per_step": self.total / self.steps,
            "loader_wait": self.waited / self.total,
            "peak_memory_mb": peak,
        }
        self._reset()
        return values
