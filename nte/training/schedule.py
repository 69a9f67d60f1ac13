"""The schedule of a run: the learning rate and the weight of the occlusion loss at every step.

Both are functions of the step alone. The phases that name no schedule share the optimiser's; a phase that names one has
it for itself, so that a run can be extended without another past.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

from nte.training.config import OptimiserConfig, PhaseConfig


class Settings(NamedTuple):
    """What the schedule says about one step."""

    learning_rate: float
    occlusion: float  # weight of the occlusion loss, multiplied by the configured one


class Schedule:
    """The settings of every step. lengths: number of steps of each phase."""

    def __init__(self, optimiser: OptimiserConfig, phases: Sequence[PhaseConfig], lengths: Sequence[int]) -> None:
        self.optimiser = optimiser
        self.phases = list(zip(phases, lengths, strict=False))
        self.shared = optimiser.steps or sum(length for phase, length in self.phases if not phase.schedule)

    @property
    def last(self) -> int:
        """Number of steps in all."""
        return sum(length for _, length in self.phases)

    def at(self, step: int) -> Settings:
        """Return the settings of a step, 0 to last − 1."""
        before = shared = 0
        for phase, length in self.phases:
            if step < before + length:
                place = step - before
                if phase.schedule:
                    rate = phase.learning_rate or self.optimiser.learning_rate
                    return Settings(rate * _decay(phase.schedule, place, length), phase.occlusion)
                return Settings(learning_rate(self.optimiser, shared + place, self.shared), phase.occlusion)
            before += length
            shared += 0 if phase.schedule else length
        raise IndexError(f"step {step} of {before}")

    def difference(self, other: "Schedule", steps: int) -> str:
        """Say what differs from another schedule in the first `steps` steps; empty if nothing does."""
        if other.last < steps:
            return f"it ends after step {other.last}, and {steps} are done"
        for step in range(steps):
            ours, theirs = self.at(step), other.at(step)
            for name, was, would in zip(Settings._fields, ours, theirs, strict=True):
                if was != would:
                    return f"the {name.replace('_', ' ')} of step {step + 1} was {was:.6g} and would be {would:.6g}"
        return ""


def learning_rate(config: OptimiserConfig, step: int, steps: int) -> float:
    """Compute the learning rate of a step, 0 to steps − 1: linear warm-up, then constant or half a cosine down to 0."""
    warm = min(1.0, (step + 1) / config.warmup_steps) if config.warmup_steps else 1.0
    return config.learning_rate * warm * _decay(config.schedule, step, steps)


def _decay(schedule: str, step: int, steps: int) -> float:
    return 0.5 * (1 + math.cos(math.pi * min(step, steps) / steps)) if schedule == "cosine" else 1.0
