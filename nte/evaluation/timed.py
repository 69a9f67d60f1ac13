"""A denoiser with a stop-watch."""

import time

import torch

from nte.denoiser import Denoiser, Result, State
from nte.frames.frame import Frame


class Timed(Denoiser):
    """A denoiser with a stop-watch around its step alone."""

    def __init__(self, denoiser: Denoiser, device: str) -> None:
        self.denoiser = denoiser
        self.needs, self.optional, self.target = denoiser.needs, denoiser.optional, denoiser.target
        self.extras = denoiser.extras
        self.clock = torch.device(device)
        self.seconds: list[float] = []

    def step(self, frame: Frame, state: State | None, extras: tuple[str, ...] = ()) -> tuple[Result, State]:
        self._wait()
        start = time.perf_counter()
        result = self.denoiser.step(frame, state, extras)
        self._wait()
        self.seconds.append(time.perf_counter() - start)
        return result

    def _wait(self) -> None:
        if self.clock.type != "cpu":
            torch.accelerator.synchronize(self.clock)
