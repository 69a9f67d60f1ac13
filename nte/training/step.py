"""One step of training: batches, the unrolled loss over their windows, gradients, optimiser."""

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

import torch
from torch import Tensor, nn
from torch.optim import Optimizer

from nte.errors import NteError
from nte.machine import convolution_peak
from nte.models.trainable import TrainableDenoiser
from nte.training.batch import Batch
from nte.training.config import OptimiserConfig, TrainConfig
from nte.training.losses import Past, SequenceLoss, Unrolled, windows
from nte.training.meter import Meter
from nte.training.schedule import Settings

if TYPE_CHECKING:
    from lightning_fabric import Fabric


class DivergedError(NteError):
    """An error about a loss or a gradient that is not finite; the weights are still those before the step."""


class Stepper:
    """A step of the optimiser over `accumulate` batches, cut into windows of `data.window` frames.

    model, optimiser: as Fabric has set them up; the model is a SequenceLoss. Only one window's graph is in memory.
    """

    def __init__(
        self, fabric: "Fabric", model: nn.Module, optimiser: Optimizer, config: TrainConfig, meter: Meter
    ) -> None:
        self.fabric, self.model, self.optimiser, self.meter = fabric, model, optimiser, meter
        self.config = config
        self.windows = windows(config.data.frames, config.data.warmup, config.data.window)

    def step(self, batches: Iterator[Batch], settings: Settings) -> tuple[Tensor, dict[str, Tensor]]:
        """Take the next batches and do one step; return the loss and its parts as means per frame.

        Raises DivergedError, before the weights change, if the loss or its gradient is not finite.
        """
        count = self.config.optimiser.accumulate
        self.optimiser.param_groups[0]["lr"] = settings.learning_rate
        self.meter.begin()
        losses, parts = [], []
        for number in range(count):
            batch = self.fabric.to_device(next(batches))
            self.meter.lap("data")
            past: Past | None = None
            for window in self.windows:
                last = number + 1 == count and window is self.windows[-1]
                with self.fabric.no_backward_sync(self.model, enabled=not last):
                    unrolled = self._forward(batch, settings, window, past)
                    self.fabric.backward(unrolled.loss / count)
                self.meter.lap("backward")
                past = unrolled.past
                losses.append(unrolled.loss.detach())
                parts.append((window, unrolled.parts))
        self._update()
        self.meter.end()
        return torch.stack(losses).sum() / count, _means(parts)

    def _forward(self, batch: Batch, settings: Settings, window: slice, past: Past | None) -> Unrolled:
        unrolled: Unrolled = self.model(batch, settings.occlusion, self.config.data.warmup, window, past)
        if not unrolled.loss.isfinite():
            raise DivergedError(f"the loss is {unrolled.loss.item()}")
        self.meter.lap("forward")
        return unrolled

    def _update(self) -> None:
        most = self.config.optimiser.clip_norm or math.inf
        norm = self.fabric.clip_gradients(self.model, self.optimiser, max_norm=most, error_if_nonfinite=False)
        if norm is None or not norm.isfinite():  # before it reaches the weights and a checkpoint
            raise DivergedError("the gradient is not finite")
        self.optimiser.step()
        self.optimiser.zero_grad()
        self.meter.lap("optimiser")


def make_loss(denoiser: TrainableDenoiser, config: TrainConfig, device: torch.device) -> SequenceLoss:
    """Make the loss of the configuration around a denoiser, and give its weights their layout in memory.

    Takes three seconds on two cores where the precision is to be measured.
    """
    if config.channels_last:
        denoiser.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    return SequenceLoss(denoiser, config.loss, _is_mixed(config.precision, device))


def _is_mixed(precision: str, device: torch.device) -> bool:
    """Whether a precision of the configuration is bfloat16 on a device.

    What lacks it computes in it all the same, but emulated: a step of the quick start took 4.1 s instead of 0.8 on a
    processor with AVX2 alone.
    """
    if precision != "auto":
        return precision == "bf16-mixed"
    with torch.random.fork_rng(devices=[]):  # the speed must not change what the seed draws
        bfloat16, float32 = (convolution_peak(device, kind, training=True) for kind in (torch.bfloat16, torch.float32))
    return bfloat16 > float32


def make_optimiser(module: nn.Module, config: OptimiserConfig) -> torch.optim.Optimizer:
    """Make the configured optimiser over all parameters."""
    kind = torch.optim.AdamW if config.name == "adamw" else torch.optim.Adam
    return kind(module.parameters(), lr=config.learning_rate, weight_decay=config.weight_decay)


def _means(parts: list[tuple[slice, dict[str, Tensor]]]) -> dict[str, Tensor]:
    """Each part's mean over windows, weighted by their frames."""
    means = {}
    for name in dict.fromkeys(name for _, found in parts for name in found):
        has = [(window.stop - window.start, found[name]) for window, found in parts if name in found]
        total = sum(frames for frames, _ in has)
        means[name] = torch.stack([value * (frames / total) for frames, value in has]).sum()
    return means
