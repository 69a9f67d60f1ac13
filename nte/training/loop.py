"""The training loop, top to bottom: batches, unrolled loss, optimiser, checkpoints."""

import math
import os
from collections.abc import Sequence
from contextlib import closing, nullcontext
from pathlib import Path
from typing import Any, cast

import torch
from lightning_fabric import Fabric
from torch import Tensor, nn
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn
from torch.utils.tensorboard import SummaryWriter
from tqdm import tqdm

from nte.errors import NteError
from nte.files import only_writer
from nte.frames.channels import reference_of, way_to
from nte.frames.clip import Clip
from nte.interrupt import InterruptFlag
from nte.models.registry import make_network
from nte.models.trainable import TrainableDenoiser
from nte.training.checkpoint import CHECKPOINT, load_module, load_optimiser, module_state, optimiser_state
from nte.training.config import OptimiserConfig, TrainConfig, load_train_config
from nte.training.data import TrainingSteps, open_clips, training_loader
from nte.training.losses import HIDDEN, SequenceLoss
from nte.training.meter import Meter
from nte.training.plan import Plan, digests
from nte.training.run import DECODED, RunFolder
from nte.training.target import Target
from nte.training.validation import ValidationSet, spread, validate


def train(
    config: TrainConfig | Path | str, force: bool = False, device: str = "auto", overrides: Sequence[str] = ()
) -> Path:
    """Train as configured and return the run folder.

    config: the configuration, or its YAML file. force: replace a run that exists. device: auto, cpu, cuda, cuda:1, …
    overrides: `key=value` for the file, such as `resume=true`. Training ends after the steps of its phases, never by
    the clock; Ctrl-C stops it after the current step. Raises NteError for wrong data or configuration, for a run that
    exists without `force`, if another process trains in the run's folder, and if the loss or its gradient is not
    finite.

    >>> run = nte.train("config.yaml", device="cpu", overrides=["name=mine"])
    step 1: loss ...
    >>> str(run)
    'runs/mine'
    """
    if not isinstance(config, TrainConfig):
        config = load_train_config(Path(config), list(overrides))
    elif overrides:
        raise NteError("overrides are for a configuration's file: set the values of a TrainConfig itself")
    fabric = _launch(device)
    torch.use_deterministic_algorithms(fabric.device.type == "cpu")
    fabric.seed_everything(config.seed, verbose=False)
    denoiser = make_network(config.network)
    run = RunFolder(Path(config.runs) / config.name)
    clips = open_clips(config.data.clips)
    channels = _channels(denoiser, config)
    data = TrainingSteps(
        clips, channels, config.data, config.seed, fabric.global_rank, fabric.world_size, run.folder / DECODED
    )
    shown = denoiser.target, reference_of(denoiser.target)  # beside the network's image
    chosen = _validation_set(config, clips, (*denoiser.needs, *shown))
    plan = Plan(
        fabric.world_size, [phase.length(data.epoch) for phase in config.phases], digests(clips), digests(chosen.clips)
    )
    with only_writer(run.folder) if fabric.is_global_zero else nullcontext():
        if fabric.is_global_zero:
            RunFolder.begin(config, plan, force)
        fabric.barrier()
        try:
            _run(config, fabric, denoiser, data, chosen, plan, run)
        finally:
            if fabric.local_rank == 0:  # on every machine, as each may have its own disk
                run.forget_decoded()
    return run.folder


def _run(
    config: TrainConfig, fabric: Fabric, denoiser: TrainableDenoiser, data: TrainingSteps, chosen: ValidationSet,
    plan: Plan, run: RunFolder,
) -> None:  # fmt: skip
    """Train, from the run's checkpoint if there is one."""
    sequence = SequenceLoss(denoiser, config.loss, config.precision)
    optimiser = make_optimiser(denoiser, config.optimiser)
    model, optimiser = fabric.setup(sequence, optimiser)
    average = AveragedModel(denoiser, multi_avg_fn=get_ema_multi_avg_fn(config.optimiser.ema))  # type: ignore[no-untyped-call]
    state = TrainingState(denoiser, optimiser, average if config.optimiser.ema else None)
    last = plan.last
    first = state.resume(run, last)
    if fabric.is_global_zero:
        run.forget_after(first)
    occlusion = [p.occlusion for p, length in zip(config.phases, plan.steps, strict=True) for _ in range(length)]

    writer = SummaryWriter(str(run.folder), purge_step=first) if fabric.is_global_zero else None
    meter = Meter(config.data.batch * config.data.frames * fabric.world_size)
    shown = None if fabric.is_global_zero else True  # None: on a terminal
    bar = tqdm(total=last, initial=first, desc=f"train {config.name}", unit="step", disable=shown)
    done = first
    with InterruptFlag() as interrupted, closing(training_loader(data, first, last)) as loader:
        for step in range(first, last):
            meter.begin()
            batch = fabric.to_device(next(loader))
            meter.loaded()
            optimiser.param_groups[0]["lr"] = learning_rate(config.optimiser, step, last)
            loss, parts = model(batch, occlusion[step], config.data.warmup)
            _require_finite(loss, "loss", step, data)
            fabric.backward(loss)
            norm = fabric.clip_gradients(
                model, optimiser, max_norm=config.optimiser.clip_norm or math.inf, error_if_nonfinite=False
            )
            _require_finite(norm, "gradient", step, data)  # before it reaches the weights and a checkpoint
            optimiser.step()
            optimiser.zero_grad()
            average.update_parameters(denoiser)
            meter.end()

            done = step + 1
            bar.update()
            # All processes stop after the same step, or one would wait for the others forever.
            stop = done == last or fabric.strategy.reduce_boolean_decision(interrupted(), all=False)
            if not fabric.is_global_zero:
                if stop:
                    break
                continue
            assert writer is not None
            if done % config.log_every == 0 or stop:
                values = {"loss": loss.item()} | {name: part.item() for name, part in parts.items()} | meter.read()
                _log(run, writer, done, values, optimiser.param_groups[0]["lr"], bar)
            if done % config.validate_every == 0 or done == last:
                trained = cast(TrainableDenoiser, average.module) if config.optimiser.ema else denoiser
                found = validate(trained, chosen)
                _log(run, writer, done, found.scores, None, bar)
                writer.add_image("validation/noisy, denoised, reference", found.picture, done)
                run.save_best(done, found.psnr, state.trained())
            if done % config.checkpoint_every == 0 or stop:
                run.save(done, state.tensors())
            if stop:
                break
    bar.close()
    if writer is not None:
        writer.close()
    if done < last and fabric.is_global_zero:
        print(f"stopped after step {done} of {last}; continue with resume=true")


def _channels(denoiser: TrainableDenoiser, config: TrainConfig) -> tuple[str, ...]:
    """The clips' channels that training reads; raises NteError for a loss that this network cannot have."""
    for i, phase in enumerate(config.phases):
        if phase.occlusion * config.loss.occlusion > 0 and HIDDEN not in denoiser.extras:
            what = f"network '{config.network.kind}' gives no '{HIDDEN}'"
            raise NteError(f"'phases[{i}].occlusion' is {phase.occlusion}, but the {what}: set it to 0")
    if missing := [name for name, weight in config.loss.lights.items() if weight and name not in denoiser.components]:
        what = f"network '{config.network.kind}' does not give '{missing[0]}' apart"
        raise NteError(f"loss.lights has '{missing[0]}', but the {what}: leave it out")
    # What the network lists only to measure a scalar from, the batches need not hold: they have the scalar.
    seen = [name for name in (*denoiser.needs, *denoiser.optional) if name in denoiser.inputs]
    return tuple(dict.fromkeys([*seen, *config.loss.channels(Target(denoiser.target))]))


def _validation_set(config: TrainConfig, clips: Sequence[Clip], channels: Sequence[str]) -> ValidationSet:
    """The validation clips of the configuration, or else the held-out last frames of some training clips."""
    own = open_clips(config.data.validation) if config.data.validation else []
    for clip in own or clips:
        if missing := [name for name in channels if name not in clip.channels]:
            have = ", ".join(clip.channels)
            what = f"{clip.folder}: validation needs the channel '{missing[0]}'; the clip has {have}"
            raise NteError(what + way_to(missing[:1]))
    frames = 0 if own else max(1, config.data.holdout)
    return ValidationSet(spread(own or clips, config.validate_clips), frames)


def _require_finite(value: Tensor | None, name: str, step: int, data: TrainingSteps) -> None:
    """Raise NteError for a loss or a gradient that is not finite; bad reference pixels are never the cause."""
    if value is None or not value.isfinite():
        found = "is not finite" if value is None or name == "gradient" else f"is {value.item()}"
        raise NteError(
            f"step {step}: the {name} {found}: lower the learning rate, or look at the data: {data.describe(step)}"
        )


class TrainingState:
    """The state of training as named tensors: weights, their moving average, optimiser and random state."""

    def __init__(self, denoiser: nn.Module, optimiser: Any, average: AveragedModel | None) -> None:
        self.denoiser, self.optimiser, self.average = denoiser, optimiser, average

    def tensors(self) -> dict[str, Tensor]:
        """Collect weights, moving average, optimiser and random state, by name."""
        state = module_state("denoiser.", self.denoiser) | optimiser_state(self.optimiser)
        if self.average is not None:
            state |= module_state("average.", self.average)
        # Batches depend on (seed, step) alone; the generator is kept for layers that draw numbers.
        return state | {"random.torch": torch.get_rng_state()}

    def trained(self) -> dict[str, Tensor]:
        """Return the weights that are used after training: their moving average if there is one."""
        if self.average is None:
            return module_state("denoiser.", self.denoiser)
        return module_state("average.", self.average)

    def resume(self, run: RunFolder, last: int) -> int:
        """Load the run's checkpoint and return the number of steps done; 0 without a checkpoint.

        Raises NteError for a checkpoint that does not fit, or of a step after the last.
        """
        loaded = run.load()
        if loaded is None:
            return 0
        step, state = loaded
        if step > last:
            raise NteError(f"{run.folder / CHECKPOINT}: is of step {step}, but the run ends after step {last}")
        load_module(self.denoiser, state, "denoiser.", run.folder / CHECKPOINT)
        if self.average is not None:
            load_module(self.average, state, "average.", run.folder / CHECKPOINT)
        load_optimiser(self.optimiser, state, run.folder / CHECKPOINT)
        if "random.torch" not in state:
            raise NteError(f"{run.folder / CHECKPOINT}: does not fit the configuration: 'random.torch' is missing")
        torch.set_rng_state(state["random.torch"])
        return step


def make_optimiser(module: nn.Module, config: OptimiserConfig) -> torch.optim.Optimizer:
    """Make the configured optimiser over all parameters."""
    kind = torch.optim.AdamW if config.name == "adamw" else torch.optim.Adam
    return kind(module.parameters(), lr=config.learning_rate, weight_decay=config.weight_decay)


def learning_rate(config: OptimiserConfig, step: int, steps: int) -> float:
    """Compute the learning rate of a step, 0 to steps − 1: linear warm-up, then constant or half a cosine down to 0."""
    warm = min(1.0, (step + 1) / config.warmup_steps) if config.warmup_steps else 1.0
    cosine = 0.5 * (1 + math.cos(math.pi * step / steps)) if config.schedule == "cosine" else 1.0
    return config.learning_rate * warm * cosine


def _log(
    run: RunFolder, writer: SummaryWriter, step: int, values: dict[str, float], rate: float | None, bar: Any
) -> None:
    values = values if rate is None else values | {"learning_rate": rate}
    run.log({"step": step, **values})
    for name, value in values.items():
        writer.add_scalar(name, value, step)
    line = f"step {step}: " + ", ".join(f"{name} {value:.4g}" for name, value in values.items())
    if bar.disable:
        print(line, flush=True)
    else:
        bar.set_postfix_str(f"loss {values['loss']:.4f}" if "loss" in values else "")


def _launch(device: str) -> Fabric:
    """Start one process on one device; under torchrun one of its processes, on the device of its local rank.

    Raises NteError for a device that does not exist.
    """
    kind, _, index = device.partition(":")
    processes = int(os.environ.get("LOCAL_WORLD_SIZE", 1)) if "TORCHELASTIC_RUN_ID" in os.environ else 0
    devices: Any = processes or ([int(index)] if index.isdigit() else 1)
    try:
        # Fabric's own mixed precision would round the inputs to bfloat16, including every motion vector.
        fabric = Fabric(
            accelerator=kind,
            devices=devices,
            num_nodes=int(os.environ.get("GROUP_WORLD_SIZE", 1)),
            strategy="ddp" if processes else "auto",
            precision="32-true",
        )
        fabric.launch()
    except (ValueError, RuntimeError, AssertionError) as error:
        raise NteError(f"--device {device}: {str(error).splitlines()[0]}") from error
    return fabric
