"""Training runs small enough for tests: a network of a few hundred weights on four frames of 40×24."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

from safetensors import safe_open
from torch import Tensor

from nte.training.config import TrainConfig, load_train_config

ROOT = Path(__file__).parents[2]
TIMINGS = ("frames_per_second", "seconds_per_step", "loader_wait", "peak_memory_mb")

CONFIG = """
name: tiny
data: {{clips: [{clip}], frames: 2, crop: 16, batch: 2, any_start: true, holdout: 1, augment: true}}
network: {{channels: [4, 4], scales: 2, kernel_size: 3, downsample: mean}}
optimiser: {{name: adamw, learning_rate: 1.0e-2, schedule: cosine, clip_norm: 1.0, ema: 0.9}}
phases: [{{steps: 4}}, {{steps: 4, occlusion: 0.5}}]
checkpoint_every: 2
validate_every: 4
log_every: 1
runs: {runs}
"""


def config_file(folder: Path, clip: Path) -> Path:
    """The configuration, for runs below `folder`."""
    path = folder / "tiny.yaml"
    path.write_text(CONFIG.format(clip=clip, runs=folder / "runs"))
    return path


def tiny_config(folder: Path, clip: Path, *overrides: str) -> TrainConfig:
    return load_train_config(config_file(folder, clip), list(overrides))


def start(path: Path, *overrides: str, launcher: tuple[str, ...] = ("train.py",)) -> "subprocess.Popen[str]":
    """`python train.py CONFIG.yaml key=value …` in a process group of its own.

    What it says goes through a short pipe: it cannot run far ahead of who listens, however busy the machine is.
    """
    command = [sys.executable, *launcher, str(path), *overrides, "--device", "cpu"]
    return subprocess.Popen(
        command, cwd=ROOT, env=os.environ | {"PYTHONUNBUFFERED": "1"}, text=True, start_new_session=True,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, pipesize=4096,
    )  # fmt: skip


def checkpoint(run: Path) -> dict[str, Tensor]:
    """Every tensor of a run's checkpoint, and the step as «step»."""
    with safe_open(run / "checkpoint.safetensors", framework="pt") as file:
        tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
        return tensors | {"step": file.metadata()["step"]}


def metrics(run: Path) -> list[dict[str, Any]]:
    """What a run has logged, without the clock and the memory."""
    lines = [json.loads(line) for line in (run / "metrics.jsonl").read_text().splitlines()]
    return [{key: value for key, value in line.items() if key not in TIMINGS} for line in lines]


def assert_same_run(run: Path, expected: Path) -> None:
    """Weights, moving average, optimiser, random state and metrics are the same, bit for bit."""
    ours, theirs = checkpoint(run), checkpoint(expected)
    assert ours.pop("step") == theirs.pop("step")
    assert ours.keys() == theirs.keys()
    for name, tensor in ours.items():
        assert tensor.numpy().tobytes() == theirs[name].numpy().tobytes(), name
    assert metrics(run) == metrics(expected)


def copied(finished: Path, folder: Path) -> Path:
    """The finished run once more, where `tiny_config(folder, …)` expects it."""
    return Path(shutil.copytree(finished, folder / "runs" / "tiny"))


def contents(folder: Path) -> dict[str, bytes]:
    """Every file of a folder."""
    return {path.name: path.read_bytes() for path in folder.iterdir()}
