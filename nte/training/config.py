"""The schema of a training configuration: every choice of a run."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from omegaconf import MISSING

from nte.config import load_config
from nte.errors import NteError
from nte.files import is_folder_name
from nte.models.registry import DEFAULT, network_type
from nte.models.trainable import NetworkConfig
from nte.training.losses import LossConfig


@dataclass
class DataConfig:
    """The training clips, and how samples are taken from them."""

    clips: list[str] = field(default_factory=lambda: MISSING)  # clip folders, or folders that hold clips
    frames: int = 9  # length of a sequence
    crop: int = 0  # side of a square crop, in pixels; 0 takes whole frames
    batch: int = 1  # sequences per step, in each process
    warmup: int = 0  # first frames of a sequence that are denoised but not counted in the loss
    any_start: bool = False  # true: sequences start at any frame; false: at the clip's first
    holdout: int = 1  # last frames of every clip that are never trained on, for validation
    augment: bool = False  # true for flips, transposes and colour permutations
    workers: int = 0  # loading processes; 0 loads between steps, which is best if everything fits the cache
    cache_gb: float = 4.0  # GiB: decoded clips are kept in memory if all of them fit, once per worker; else in files
    cache_dir: str = ""  # folder of these files, kept and shared between runs; empty: in the run folder, until it ends
    scatter: float = 0.0  # share of sequences whose previous_forward_motion is made from motion, as in most engines
    validation: list[str] = field(default_factory=list)  # validation clips; none: held-out frames of training clips


@dataclass
class OptimiserConfig:
    """The optimiser, Adam or AdamW, with a learning rate that depends on the step alone."""

    name: str = "adam"  # adam or adamw
    learning_rate: float = 1e-4
    weight_decay: float = 0.0
    schedule: str = "constant"  # constant or cosine (to zero at the last step)
    warmup_steps: int = 0  # steps in which the learning rate rises linearly
    clip_norm: float = 0.0  # largest norm of the gradient; 0 does not clip
    ema: float = 0.0  # decay of the moving average of the weights that is used after training; 0: no average


@dataclass
class PhaseConfig:
    """A phase of training, in epochs or in steps, with its weight of the occlusion loss."""

    epochs: int = 0
    steps: int = 0
    occlusion: float = 0.0  # multiplied by loss.occlusion

    def length(self, epoch: int) -> int:
        """Return the number of steps of the phase. epoch: number of steps of an epoch."""
        return self.steps or self.epochs * epoch


@dataclass
class TrainConfig:
    """All choices of a training run."""

    name: str = MISSING  # name of the run folder
    seed: int = 1
    data: DataConfig = field(default_factory=DataConfig)
    network: NetworkConfig = MISSING  # the configuration class of the network that its `kind` names
    loss: LossConfig = field(default_factory=LossConfig)
    optimiser: OptimiserConfig = field(default_factory=OptimiserConfig)
    phases: list[PhaseConfig] = field(default_factory=lambda: MISSING)
    precision: str = "32-true"  # or bf16-mixed
    checkpoint_every: int = 500  # steps
    validate_every: int = 500  # steps
    validate_clips: int = 8  # largest number of validation clips, spread over their families
    log_every: int = 20  # steps
    runs: str = "runs"  # folder that holds the run folders
    resume: bool = False  # true to continue the run from its checkpoint


def load_train_config(path: Path, overrides: list[str]) -> TrainConfig:
    """Read and check a training configuration, with `key=value` overrides.

    Raises NteError, naming the file and the key, for a value that is not allowed.
    """
    config = read_train_config(path, overrides)
    try:
        _check(config)
    except NteError as error:
        raise NteError(f"{path}: {error}") from error
    return config


def read_train_config(path: Path, overrides: Sequence[str] = ()) -> TrainConfig:
    """Read a training configuration without checking its values, such as that of a run folder.

    overrides: `key=value`. Raises NteError, naming the file and the key, for unknown keys and wrong types.
    """
    return load_config(TrainConfig, path, overrides, _of_its_network)


def _of_its_network(said: Callable[[str], Any]) -> TrainConfig:
    """The default configuration with the kind of network that `network.kind` names, or with DEFAULT."""
    kind = said("network.kind")
    kind = DEFAULT if kind is None else kind
    return TrainConfig(network=network_type(kind).Config(kind=kind))


def _check(config: TrainConfig) -> None:
    config.network.check()
    config.loss.check()
    _one_of("optimiser.name", config.optimiser.name, ("adam", "adamw"))
    _one_of("optimiser.schedule", config.optimiser.schedule, ("constant", "cosine"))
    _one_of("precision", config.precision, ("32-true", "bf16-mixed"))
    if not is_folder_name(config.name):
        raise NteError(f"'name' is '{config.name}', expected the name of a folder in '{config.runs}'")
    for key in ("frames", "batch"):
        _within(f"data.{key}", getattr(config.data, key), 1)
    for key in ("crop", "warmup", "holdout", "workers"):
        _within(f"data.{key}", getattr(config.data, key), 0)
    for key in ("checkpoint_every", "validate_every", "validate_clips", "log_every"):
        _within(key, getattr(config, key), 1)
    for key in ("learning_rate", "weight_decay", "warmup_steps", "clip_norm"):
        _within(f"optimiser.{key}", getattr(config.optimiser, key), 0)
    for key in ("spatial", "temporal", "occlusion", "irradiance"):
        _within(f"loss.{key}", getattr(config.loss, key), 0)
    _within("optimiser.ema", config.optimiser.ema, 0, 1)
    _within("data.scatter", config.data.scatter, 0, 1)
    _within("data.cache_gb", config.data.cache_gb, 0)
    _within("seed", config.seed, 0, 2**32 - 1)  # the range that NumPy's and PyTorch's generators share
    if config.data.warmup >= config.data.frames:
        raise NteError(f"'data.warmup' is {config.data.warmup}, expected less than data.frames")
    if not config.phases:
        raise NteError("'phases' is empty: give at least one")
    for i, phase in enumerate(config.phases):
        for key in ("epochs", "steps", "occlusion"):
            _within(f"phases[{i}].{key}", getattr(phase, key), 0)
        if (phase.epochs > 0) == (phase.steps > 0):
            raise NteError(f"'phases[{i}]' needs either 'epochs' or 'steps'")


def _one_of(key: str, value: str, allowed: tuple[str, ...]) -> None:
    if value not in allowed:
        raise NteError(f"'{key}' is '{value}', expected one of {', '.join(allowed)}")


def _within(key: str, value: float, low: float, high: float = math.inf) -> None:
    """Raise NteError unless a value is finite and within [low, high], which NaN is not."""
    if not (low <= value <= high and value < math.inf):
        raise NteError(f"'{key}' is {value}, expected {f'at least {low}' if high == math.inf else f'{low} to {high}'}")
