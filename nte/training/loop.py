"""The training loop, top to bottom: clips, run folder, steps, validation, checkpoints."""

from collections.abc import Sequence
from contextlib import closing, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, cast

from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn

from nte.errors import NteError
from nte.interrupt import InterruptFlag
from nte.models.registry import make_network
from nte.models.trainable import TrainableDenoiser
from nte.progress import Progress
from nte.training.config import TrainConfig, load_train_config
from nte.training.data import training_loader
from nte.training.initial import begin_with, read_weights
from nte.training.log import RunLog
from nte.training.material import Material, open_material
from nte.training.meter import Meter
from nte.training.plan import Plan, digests
from nte.training.processes import launch, needing_each_other
from nte.training.run import DECODED, RunFolder
from nte.training.schedule import Schedule
from nte.training.state import TrainingState
from nte.training.step import DivergedError, Stepper, make_loss, make_optimiser
from nte.training.validation import validate
from nte.writers import only_writer

if TYPE_CHECKING:
    from lightning_fabric import Fabric


def train(
    config: TrainConfig | Path | str, force: bool = False, device: str = "auto", overrides: Sequence[str] = ()
) -> Path:
    """Train as configured and return the run folder.

    config: the configuration, or its YAML file. force: replace a run that exists. device: auto, cpu, cuda, cuda:1, …
    overrides: `key=value` for the file, such as `resume=true`. Training ends after the steps of its phases, never by
    the clock; Ctrl-C stops it after the current step, and then raises KeyboardInterrupt. Raises NteError for wrong data
    or configuration, for a run that exists without `force`, if another process trains in the run's folder, if one of
    several processes has ended or does not answer, and if the loss or its gradient is not finite.

    >>> run = nte.train("config.yaml", device="cpu", overrides=["name=mine"])
    step 1: loss ...
    >>> str(run)
    'runs/mine'
    """
    if not isinstance(config, TrainConfig):
        config = load_train_config(Path(config), list(overrides))
    elif overrides:
        raise NteError("overrides are for a configuration's file: set the values of a TrainConfig itself")
    fabric = launch(device, config.seed)
    denoiser = make_network(config.network)
    begun = read_weights(Path(config.init_from)) if config.init_from else None
    said = begin_with(denoiser, begun) if begun else ""
    run = RunFolder(Path(config.runs) / config.name)
    material = open_material(config, denoiser, run.folder / DECODED, fabric.global_rank, fabric.world_size)
    lengths = [phase.length(material.data.epoch, config.optimiser.accumulate) for phase in config.phases]
    clips, validation = material.data.clips, material.validation.clips
    plan = Plan(fabric.world_size, lengths, digests(clips), digests(validation), begun.digest if begun else "")
    with needing_each_other(fabric), only_writer(run.folder) if fabric.is_global_zero else nullcontext():
        if fabric.is_global_zero:
            RunFolder.begin(config, plan, force)
        fabric.barrier()
        try:
            _run(config, fabric, denoiser, material, Schedule(config.optimiser, config.phases, lengths), run, said)
        finally:
            if fabric.local_rank == 0:  # on every machine, as each may have its own disk
                run.forget_decoded()
    return run.folder


def _run(
    config: TrainConfig, fabric: "Fabric", denoiser: TrainableDenoiser, material: Material, schedule: Schedule,
    run: RunFolder, said: str,
) -> None:  # fmt: skip
    """Train, from the run's checkpoint if there is one. said: about the weights that a new run begins with."""
    objective = make_loss(denoiser, config, fabric.device)
    model, optimiser = fabric.setup(objective, make_optimiser(denoiser, config.optimiser))
    average = AveragedModel(denoiser, multi_avg_fn=get_ema_multi_avg_fn(config.optimiser.ema))  # type: ignore[no-untyped-call]
    state = TrainingState(denoiser, optimiser, average if config.optimiser.ema else None)
    last, data, accumulate = schedule.last, material.data, config.optimiser.accumulate
    first = state.resume(run, last)
    if fabric.is_global_zero:
        run.forget_after(first)
        if said and not first:
            print(said, flush=True)
        if config.precision == "auto":
            print(f"precision: {'bf16-mixed' if objective.mixed else '32-true'}, the faster one here", flush=True)

    meter = Meter(config.data.batch * config.data.frames * accumulate * fabric.world_size)
    stepper = Stepper(fabric, model, optimiser, config, meter)
    progress = Progress(f"train {config.name}", last, "step", fabric.is_global_zero, first)
    log = RunLog(run.folder, first, progress) if fabric.is_global_zero else None
    done = saved = first

    def judge(step: int) -> None:
        assert log is not None
        trained = cast(TrainableDenoiser, average.module) if config.optimiser.ema else denoiser
        found = validate(trained, material.validation)
        log.picture(step, "validation/noisy, denoised, reference", found.picture)
        run.save_best(step, found.psnr, state.trained())
        log.values(step, found.scores)  # last: a validation that is logged has left all that it leaves

    if log is not None and first and _is_judged(first, last, config) and not run.was_judged(first):
        judge(first)  # the run was stopped between its checkpoint and the validation
    loader = training_loader(data, first * accumulate, last * accumulate, fabric.device.type != "cpu")
    with InterruptFlag() as interrupted, closing(loader), progress:
        for step in range(first, last):
            settings = schedule.at(step)
            try:
                loss, parts = stepper.step(loader, settings)
            except DivergedError as error:
                raise _diverged(error, step, saved, data.describe(_batches(step, accumulate))) from error
            average.update_parameters(denoiser)

            done = step + 1
            progress.advance(1)
            # All processes stop after the same step, or one would wait for the others forever.
            stop = done == last or fabric.strategy.reduce_boolean_decision(interrupted(), all=False)
            if not fabric.is_global_zero:
                if stop:
                    break
                continue
            assert log is not None
            if done % config.log_every == 0 or stop:
                values = {"loss": loss.item()} | {name: part.item() for name, part in parts.items()} | meter.read()
                log.values(done, values | {"learning_rate": settings.learning_rate})
            kept = stop or done % config.checkpoint_every == 0 or done % config.validate_every == 0
            if kept and (bad := state.not_finite()):  # a finite gradient can still give such weights
                fault = DivergedError(f"'{bad}' is not finite")
                raise _diverged(fault, step, saved, data.describe(_batches(step, accumulate)))
            if done % config.checkpoint_every == 0 or stop:  # before the validation, which reads files and needs memory
                run.save(done, state.tensors())
                saved = done
            if _is_judged(done, last, config):
                judge(done)
            if stop:
                break
    if log is not None:
        log.close()
    if done < last:
        if fabric.is_global_zero:
            print(f"stopped after step {done} of {last}; continue with resume=true", flush=True)
        raise KeyboardInterrupt


def _is_judged(step: int, last: int, config: TrainConfig) -> bool:
    """Tell whether the state after this step is validated."""
    return step % config.validate_every == 0 or step == last


def _batches(step: int, accumulate: int) -> range:
    """The numbers of a step's batches."""
    return range(step * accumulate, (step + 1) * accumulate)


def _diverged(error: NteError, step: int, saved: int, seen: str) -> NteError:
    """The error for a run that has diverged in a step; its last good state stays in the checkpoint."""
    remedy = "lower the learning rate"
    if saved:
        remedy = f"the checkpoint keeps the state after step {saved}: resume it with phases of a lower learning rate"
    return NteError(f"step {step}: {error}: {remedy}, or look at the data: {seen}")
