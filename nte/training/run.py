"""The run folder, the sole identity of a run. Its files are whole or absent, and none of them is pickled.

config.yaml             every choice, resolved
plan.json               steps of each phase, processes and clips, which follow from the choices
versions.json           versions of Python and of the packages that took part
checkpoint.safetensors  weights, their moving average, optimiser and random states, and their step
best.safetensors        the weights, or their moving average, with the best validation
decoded/                clips that memory cannot hold, until the run ends
metrics.jsonl           a line per logged step and per validation
events.out.tfevents.*   the same for TensorBoard, with pictures
"""

import json
import math
import platform
import shutil
from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path

import torch
from torch import Tensor

from nte.config import to_yaml
from nte.errors import DISTRIBUTION, NteError
from nte.files import write_whole
from nte.models.registry import make_network
from nte.models.trainable import TrainableDenoiser
from nte.training.checkpoint import BEST, CHECKPOINT, load_module, read_checkpoint, weights_prefix, write_checkpoint
from nte.training.config import TrainConfig, read_train_config
from nte.training.plan import ANEW, OTHER_RUN, PLAN, Plan
from nte.training.schedule import Schedule
from nte.version import DENOISING, versions_of

DECODED = "decoded"
_LEFTOVERS = ".*.tmp"  # files that a killed process was writing
_OURS = (  # deleted in this order: no checkpoint is left without its configuration
    CHECKPOINT, BEST, "config.yaml", PLAN, "versions.json", DECODED, "metrics.jsonl", "events.out.tfevents.*",
    _LEFTOVERS,
)  # fmt: skip
# Phases and the learning rate may change from the checkpoint's step on, which Schedule compares.
_MAY_CHANGE = (
    "phases", "optimiser.learning_rate", "optimiser.schedule", "optimiser.steps", "optimiser.warmup_steps",
    "resume", "runs", "data.workers", "data.cache_gb", "data.cache_dir", "checkpoint_every", "validate_every",
    "log_every",
)  # fmt: skip


class RunFolder:
    """The files of one run. Its methods are for the folder's only writer (`nte.writers.only_writer`)."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    @classmethod
    def begin(cls, config: TrainConfig, plan: Plan, force: bool) -> "RunFolder":
        """Begin a new run folder, or open the one to resume.

        force: replace a run that exists. Raises NteError if one exists and neither `resume` nor force is given, and if
        the run to resume has another configuration, or none, another number of processes or other clips. Its phases may
        be others from the checkpoint's step on.
        """
        run = cls(Path(config.runs) / config.name)
        if config.resume and (run.folder / "config.yaml").is_file():
            run._resume(config, plan)
            return run
        if run.folder.is_dir() and any(run.folder.iterdir()):
            trained = any((run.folder / name).is_file() for name in (CHECKPOINT, BEST))
            if config.resume and trained and not force:  # without a checkpoint, it was killed before it began
                what = "config.yaml is missing, so nobody knows how the run was made"
                raise NteError(f"{run.folder}: {what}: restore it, or {ANEW}")
            if not force and not config.resume:
                raise NteError(f"{run.folder}: exists: continue it with resume=true, or overwrite it with --force")
            run._delete()
        plan.write(run.folder)
        write_whole(run.folder / "versions.json", lambda path: path.write_text(_versions(), encoding="utf-8"))
        run._write_config(config)
        return run

    def save(self, step: int, state: Mapping[str, Tensor]) -> None:
        """Replace the checkpoint by the state after `step` steps. Raises NteError if it cannot be written."""
        write_checkpoint(self.folder, step, state)

    def save_best(self, step: int, psnr: float, weights: Mapping[str, Tensor]) -> None:
        """Keep the weights after `step` steps if their validation PSNR, in dB, is the best so far."""
        best = -math.inf
        if (self.folder / BEST).is_file():
            best = read_checkpoint(self.folder, BEST)[1]["psnr"].item()
        if psnr > best:
            write_checkpoint(self.folder, step, {**weights, "psnr": torch.tensor(psnr, dtype=torch.float64)}, BEST)

    def forget_decoded(self) -> None:
        """Remove the decoded clips."""
        shutil.rmtree(self.folder / DECODED, ignore_errors=True)

    def load(self) -> tuple[int, dict[str, Tensor]] | None:
        """Read (step, state) of the checkpoint; None if there is none yet. Raises NteError if it is damaged."""
        return read_checkpoint(self.folder) if (self.folder / CHECKPOINT).is_file() else None

    def forget_after(self, step: int) -> None:
        """Remove from metrics.jsonl the lines of steps after `step`, from which the run is resumed."""
        log = self.folder / "metrics.jsonl"
        if log.is_file():
            # The last line may be half-written if the process was killed.
            lines = log.read_text(encoding="utf-8", errors="replace").splitlines(keepends=True)
            kept = "".join(line for line in lines if _step_of(line) <= step)
            write_whole(log, lambda path: path.write_text(kept, encoding="utf-8"))

    def was_judged(self, step: int) -> bool:
        """Tell whether the validation after `step` steps is in metrics.jsonl."""
        log = self.folder / "metrics.jsonl"
        lines = log.read_text(encoding="utf-8", errors="replace").splitlines(keepends=True) if log.is_file() else []
        return any('"validation_psnr"' in line and _step_of(line) == step for line in lines)

    def _write_config(self, config: TrainConfig) -> None:
        text = to_yaml(replace(config, resume=False))
        write_whole(self.folder / "config.yaml", lambda path: path.write_text(text, encoding="utf-8"))

    def _resume(self, config: TrainConfig, plan: Plan) -> None:
        """Check that the run can be continued as configured; keep its schedule if it is another one from now on."""
        before = read_train_config(self.folder / "config.yaml")
        self._require_same(before, config)
        saved = plan.require_same(self.folder)
        if (before.phases, before.optimiser, saved.steps) != (config.phases, config.optimiser, plan.steps):
            loaded = self.load()
            done = loaded[0] if loaded else 0
            past = Schedule(before.optimiser, before.phases, saved.steps)
            if changed := past.difference(Schedule(config.optimiser, config.phases, plan.steps), done):
                raise NteError(
                    f"{self.folder}: another schedule for the {done} steps that are done: {changed}; keep 'phases' and "
                    "'optimiser' as they were, and give an added phase a 'schedule' of its own, constant or cosine"
                )
            self._write_config(config)  # first: the plan's steps are those of its first phases
            plan.write(self.folder)
        for path in self.folder.glob(_LEFTOVERS):
            path.unlink()

    def _require_same(self, before: TrainConfig, config: TrainConfig) -> None:
        """Raise NteError for the first key whose value differs and that changes what is learned."""
        saved = _choices(before)
        for key, now in _choices(config).items():
            if saved.get(key) != now:  # another kind of network has other keys; its kind is the first that differs
                raise NteError(
                    f"{self.folder}: made by another configuration: '{key}' is {saved.get(key)} there and {now} here; "
                    f"{OTHER_RUN}, or restore the value"
                )

    def _delete(self) -> None:
        """Delete the run; raises NteError, and deletes nothing, if the folder has a file that no run writes."""
        files = [path for pattern in _OURS for path in self.folder.glob(pattern)]
        strangers = sorted(set(self.folder.iterdir()) - set(files))
        if strangers:
            raise NteError(f"{strangers[0]}: not a file of a run: move it away; nothing was overwritten")
        self.forget_decoded()  # the folder itself stays, as it is locked
        for path in files:
            if path.name != DECODED:
                path.unlink()


def load_run(folder: Path, device: str = "cpu") -> TrainableDenoiser:
    """Load the denoiser that a run has trained so far, with the moving average of its weights if the run keeps one.

    folder: a run folder, or a checkpoint in it: RUN/best.safetensors has the weights with the best validation. The
    denoiser is on `device`, in evaluation mode and without gradients. Raises NteError if the folder is no run, and if
    the checkpoint is missing, damaged or does not fit.
    """
    folder, name = (folder, CHECKPOINT) if folder.suffix != ".safetensors" else (folder.parent, folder.name)
    if not (folder / "config.yaml").is_file():
        raise NteError(f"{folder}: no run folder: config.yaml is missing")
    config = read_train_config(folder / "config.yaml")
    _, state = read_checkpoint(folder, name)
    denoiser = make_network(config.network)
    load_module(denoiser, state, weights_prefix(state), folder / name)
    return denoiser.to(device).eval().requires_grad_(False)


def _step_of(line: str) -> float:
    """The step of a line of metrics.jsonl; infinite for a torn line."""
    try:
        step = json.loads(line)["step"] if line.endswith("\n") else math.inf
    except (ValueError, TypeError, KeyError, RecursionError):
        return math.inf
    return step if type(step) is int else math.inf


def _choices(config: TrainConfig) -> dict[str, object]:
    """Every choice by its dotted key, except those that may change when a run is resumed."""
    flat: dict[str, object] = {}

    def collect(prefix: str, values: Mapping[str, object]) -> None:
        for key, value in values.items():
            if isinstance(value, dict):
                collect(f"{prefix}{key}.", value)
            else:
                flat[prefix + key] = value

    collect("", asdict(config))
    return {key: value for key, value in flat.items() if key not in _MAY_CHANGE}


def _versions() -> str:
    here = {"python": platform.python_version(), "machine": platform.machine()}
    packages = versions_of(DISTRIBUTION, *DENOISING, "lightning-fabric", "safetensors", "omegaconf", "OpenEXR")
    return json.dumps({**here, **packages, "threads": torch.get_num_threads()}, indent=1) + "\n"
