"""The cost of a training step: where its time goes, and how much of the machine's speed it uses.

The steps are those of a configuration, with its network and clips; nothing is written.
"""

from contextlib import closing
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import torch
from torch.profiler import ProfilerActivity, profile
from torch.utils.flop_counter import FlopCounterMode

from nte.errors import NteError
from nte.machine import convolution_peak
from nte.models.registry import make_network
from nte.text_table import aligned
from nte.training.config import TrainConfig
from nte.training.data import training_loader
from nte.training.material import open_material
from nte.training.meter import Meter
from nte.training.processes import launch
from nte.training.schedule import Schedule
from nte.training.step import Stepper, make_loss, make_optimiser

STEPS = 3  # measured, of which the fastest counts; one more before them decodes clips and allocates memory


class Profile(NamedTuple):
    """The cost of a step. Operations are multiplications and additions of convolutions and matrix products."""

    seconds: dict[str, float]  # of each stage of the fastest step that was measured
    named: dict[str, float]  # of each named part of the forward passes of a step, in seconds; parts may contain others
    operations: float  # of a step, forward and backward
    peak: float  # operations per second of a large convolution alone, forward and backward

    @property
    def share(self) -> float:
        """The share of the peak that a whole step reaches, data and optimiser included."""
        return self.operations / sum(self.seconds.values()) / self.peak

    def table(self) -> str:
        """Lay the profile out as a table, and the share of the peak in a sentence."""
        total = sum(self.seconds.values())
        inside = {f"  {name}": value for name, value in self.named.items()}
        names, values = ["stage"], ["s a step"]
        shares = ["share"]
        for name, value in self.seconds.items():
            for label, seconds in ((name, value), *(inside.items() if name == "forward" else ())):
                names.append(label)
                values.append(f"{seconds:.3f}")
                shares.append(f"{seconds / total:.0%}")
        said = (
            f"{self.operations / 1e9:.3g} GFLOP a step in {total:.3g} s: {self.share:.0%} of the {self.peak / 1e9:.3g} "
            "GFLOP/s that a large convolution alone reaches here"
        )
        return f"{aligned([names, values, shares])}\n{said}"


def profile_training(config: TrainConfig, device: str = "auto") -> Profile:
    """Measure the steps of a training without making a run.

    Raises NteError for clips that do not fit the configuration, and for a run that has fewer steps than are measured.
    """
    fabric = launch(device, config.seed)
    denoiser = make_network(config.network)
    accumulate = config.optimiser.accumulate
    with TemporaryDirectory() as cache:
        material = open_material(config, denoiser, Path(cache), fabric.global_rank, fabric.world_size)
        lengths = [phase.length(material.data.epoch, accumulate) for phase in config.phases]
        schedule = Schedule(config.optimiser, config.phases, lengths)
        if schedule.last < STEPS + 3:
            raise NteError(f"'phases' have {schedule.last} steps, expected at least {STEPS + 3} for a profile")
        loss = make_loss(denoiser, config, fabric.device)
        model, optimiser = fabric.setup(loss, make_optimiser(denoiser, config.optimiser))
        meter = Meter(1, torch.cuda.synchronize if fabric.device.type == "cuda" else None)
        stepper = Stepper(fabric, model, optimiser, config, meter)
        loader = training_loader(material.data, 0, (STEPS + 3) * accumulate, fabric.device.type != "cpu")
        settings = schedule.at(schedule.last - 1)  # with all losses that a phase adds in the end

        def stages() -> dict[str, float]:
            """The seconds of each stage of one step."""
            stepper.step(loader, settings)
            spent = dict(meter.seconds)
            meter.read()
            return spent

        with closing(loader):
            stages()
            seconds = min((stages() for _ in range(STEPS)), key=lambda spent: sum(spent.values()))
            with FlopCounterMode(display=False) as counter:
                stages()
            with profile(activities=[ProfilerActivity.CPU]) as profiler:
                slowed = stages()["forward"] / seconds["forward"]  # by the profiler
    named: dict[str, float] = {}
    for event in sorted(profiler.events(), key=lambda event: event.time_range.start):
        if event.is_user_annotation and "#" not in event.name:  # PyTorch's own have a #
            named[event.name] = named.get(event.name, 0.0) + event.time_range.elapsed_us() / 1e6 / slowed
    kind = torch.bfloat16 if loss.mixed else torch.float32
    peak = 2 * convolution_peak(fabric.device, kind, training=True)
    return Profile(seconds, named, counter.get_total_flops(), peak)
