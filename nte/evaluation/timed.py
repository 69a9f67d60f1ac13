"""A denoiser with a stop-watch."""

import time

import torch

from nte.denoiser import Denoiser, Result, State, label_of
from nte.frames.frame import Frame
from nte.machine import wait_for


class Timed(Denoiser):
    """A denoiser with a stop-watch around its step alone."""

    def __init__(self, denoiser: Denoiser, device: str) -> None:
        self.denoiser = denoiser
        self.needs, self.optional, self.target = denoiser.needs, denoiser.optional, denoiser.target
        self.extras, self.wants = denoiser.extras, denoiser.wants
        self.label = label_of(denoiser)
        self.clock = torch.device(device)
        self.seconds: list[float] = []

    def step(self, frame: Frame, state: State | None, extras: tuple[str, ...] = ()) -> tuple[Result, State]:
        wait_for(self.clock)
        start = time.perf_counter()
        result = self.denoiser.step(frame, state, extras)
        wait_for(self.clock)
        self.seconds.append(time.perf_counter() - start)
        return result
