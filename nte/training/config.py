"""The schema of a training configuration: every choice of a run."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from omegaconf import MISSING

from nte.config import Said, load_config
from nte.errors import NteError, expected_one_of
from nte.files import is_folder_name
from nte.models.registry import DEFAULT, network_type
from nte.models.trainable import NetworkConfig
from nte.shipped import shipped
from nte.training.losses import LossConfig


@dataclass
class DataConfig:
    """The training clips, and how samples are taken from them."""

    # Clip folders, or folders that hold clips; {folder: …, share: 0.2} gives one a share of the sequences.
    clips: list[Any] = field(default_factory=lambda: MISSING)
    frames: int = 9  # length of a sequence; a clip has at least frames + holdout
    crop: int = 0  # side of a square crop, in pixels; 0 takes whole frames
    batch: int = 1  # sequences per step, in each process
    warmup: int = 0  # first frames of a sequence that are denoised but not counted in the loss
    any_start: bool = False  # true: sequences start at any frame; false: at the clip's first
    holdout: int = 1  # last frames of every clip that are never trained on, for validation
    window: int = 0  # frames through which gradients flow; longer sequences are cut, their state goes on; 0: all
    augment: bool = False  # true for flips, transposes and colour permutations
    rotate: bool = False  # true for a random rotation of normals, positions and other directions of the world
    radiance: float = 0.0  # radiance times 2^±radiance, with the exposure that this gives
    exposure: float = 0.0  # exposure times 2^±exposure: sequences brighter or darker than their exposure assumes
    average: int = 1  # largest number of noise seeds whose mean is a sequence, so with so many samples per pixel
    workers: int = 0  # processes that load batches ahead; 0: none, best if everything fits the cache
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
    steps: int = 0  # of the cosine; 0: those of all phases without a schedule of their own
    warmup_steps: int = 0  # steps in which the learning rate rises linearly
    clip_norm: float = 0.0  # largest norm of the gradient; 0 does not clip
    ema: float = 0.0  # decay of the moving average of the weights that is used after training; 0: no average
    accumulate: int = 1  # batches whose gradients are averaged for a step


@dataclass
class PhaseConfig:
    """A phase of training, in epochs or in steps, with its weight of the occlusion loss."""

    epochs: int = 0
    steps: int = 0
    occlusion: float = 0.0  # multiplied by loss.occlusion
    schedule: str = ""  # constant or cosine over this phase alone; empty: part of optimiser.schedule
    learning_rate: float = 0.0  # at the start of such a schedule; 0: optimiser.learning_rate

    def length(self, epoch: int, accumulate: int = 1) -> int:
        """Return the number of steps of the phase. epoch: number of batches; accumulate: batches of a step."""
        return self.steps or -(-self.epochs * epoch // accumulate)


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
    precision: str = "32-true"  # or bf16-mixed; auto for the one in which a large convolution is faster on the device
    channels_last: bool = (
        False  # true for weights with their channels last in memory: faster on most CPUs, see --profile
    )
    checkpoint_every: int = 500  # steps
    validate_every: int = 500  # steps
    validate_clips: int = 8  # largest number of validation clips, spread over their families
    log_every: int = 20  # steps
    runs: str = "runs"  # folder that holds the run folders
    resume: bool = False  # true to continue the run from its checkpoint
    init_from: str = ""  # run or checkpoint whose weights the run begins with, where they fit by name and shape


def load_train_config(path: Path, overrides: list[str]) -> TrainConfig:
    """Read and check a training configuration, with `key=value` overrides.

    Raises NteError, naming the file and the key, for a value that is not allowed.
    """
    return load_config(TrainConfig, shipped(path), overrides, _of_its_network, _check)


def read_train_config(path: Path, overrides: Sequence[str] = ()) -> TrainConfig:
    """Read a training configuration without checking its values, such as that of a run folder.

    overrides: `key=value`. Raises NteError, naming the file and the key, for unknown keys and wrong types.
    """
    return load_config(TrainConfig, path, overrides, _of_its_network)


def _of_its_network(said: Said) -> TrainConfig:
    """The default configuration with the kind of network that `network.kind` names, or with DEFAULT."""
    kind = said("network.kind")
    kind = DEFAULT if kind is None else kind
    return TrainConfig(network=network_type(kind).Config(kind=kind))


def _check(config: TrainConfig) -> None:
    config.network.check()
    config.loss.check()
    _one_of("optimiser.name", config.optimiser.name, ("adam", "adamw"))
    _one_of("optimiser.schedule", config.optimiser.schedule, ("constant", "cosine"))
    _one_of("precision", config.precision, ("32-true", "bf16-mixed", "auto"))
    if not is_folder_name(config.name):
        raise NteError(f"'name' is '{config.name}', expected the name of a folder in '{config.runs}'")
    for key in ("frames", "batch", "average"):
        _within(f"data.{key}", getattr(config.data, key), 1)
    for key in ("crop", "warmup", "holdout", "workers", "window"):
        _within(f"data.{key}", getattr(config.data, key), 0)
    for key in ("checkpoint_every", "validate_every", "validate_clips", "log_every"):
        _within(key, getattr(config, key), 1)
    for key in ("learning_rate", "weight_decay", "warmup_steps", "clip_norm", "steps"):
        _within(f"optimiser.{key}", getattr(config.optimiser, key), 0)
    for key in ("spatial", "temporal", "occlusion", "irradiance"):
        _within(f"loss.{key}", getattr(config.loss, key), 0)
    for key in ("radiance", "exposure"):
        _within(f"data.{key}", getattr(config.data, key), 0, 16)
    _within("optimiser.accumulate", config.optimiser.accumulate, 1)
    _within("optimiser.ema", config.optimiser.ema, 0, 1)
    _within("data.scatter", config.data.scatter, 0, 1)
    _within("data.cache_gb", config.data.cache_gb, 0)
    _within("seed", config.seed, 0, 2**32 - 1)  # the range that NumPy's and PyTorch's generators share
    _check_shares(config.data.clips)
    if config.data.warmup >= config.data.frames:
        raise NteError(f"'data.warmup' is {config.data.warmup}, expected less than data.frames")
    if not config.phases:
        raise NteError("'phases' is empty: give at least one")
    for i, phase in enumerate(config.phases):
        for key in ("epochs", "steps", "occlusion", "learning_rate"):
            _within(f"phases[{i}].{key}", getattr(phase, key), 0)
        if (phase.epochs > 0) == (phase.steps > 0):
            raise NteError(f"'phases[{i}]' needs either 'epochs' or 'steps'")
        if phase.schedule:
            _one_of(f"phases[{i}].schedule", phase.schedule, ("constant", "cosine"))
        elif phase.learning_rate:
            raise NteError(f"'phases[{i}].learning_rate' needs 'phases[{i}].schedule': constant or cosine")


def folder_and_share(entry: object) -> tuple[str, float | None]:
    """Read an entry of `data.clips`: the folder, and its share of the sequences, None if it has none.

    Raises NteError for what is neither a folder nor a mapping {folder: …, share: …}.
    """
    if isinstance(entry, str):
        return entry, None
    if isinstance(entry, dict) and entry.keys() == {"folder", "share"} and isinstance(entry["folder"], str):
        share = entry["share"]
        if type(share) in (int, float) and 0 < share <= 1:
            return entry["folder"], float(share)
        raise NteError(f"'data.clips': the share of {entry['folder']} is {share!r}, expected a number in (0, 1]")
    raise NteError(f"'data.clips' has {entry!r:.80}, expected a folder, or {{folder: data/x, share: 0.2}}")


def _check_shares(entries: Sequence[object]) -> None:
    shares = [share for _, share in map(folder_and_share, entries)]
    total = sum(share for share in shares if share is not None)
    if total > 1 + 1e-6:
        raise NteError(f"'data.clips': its shares sum to {total:.6g}, expected at most 1")
    if None in shares and total > 1 - 1e-6:
        raise NteError("'data.clips': its shares sum to 1, which leaves nothing to the folders without a share")


def _one_of(key: str, value: str, allowed: tuple[str, ...]) -> None:
    if value not in allowed:
        raise NteError(f"'{key}' is '{value}'{expected_one_of(value, allowed)}")


def _within(key: str, value: float, low: float, high: float = math.inf) -> None:
    """Raise NteError unless a value is finite and within [low, high], which NaN is not."""
    if not (low <= value <= high and value < math.inf):
        raise NteError(f"'{key}' is {value}, expected {f'at least {low}' if high == math.inf else f'{low} to {high}'}")
