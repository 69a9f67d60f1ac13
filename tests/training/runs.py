"""Training runs small enough for tests: a network of a few hundred weights on four frames of 40×24."""

import fcntl
import json
import multiprocessing
import os
import resource
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import pytest
from safetensors import safe_open
from torch import Tensor

from nte.cli import main
from nte.training.config import TrainConfig, load_train_config

ROOT = Path(__file__).parents[2]
PIPE = (
    4096  # bytes that a process may say before somebody listens: it cannot run far ahead, however busy the machine is
)
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
    """`python train.py CONFIG.yaml key=value …` in a process group of its own."""
    command = [sys.executable, *launcher, str(path), *overrides, "--device", "cpu"]
    return subprocess.Popen(
        command, cwd=ROOT, env=os.environ | {"PYTHONUNBUFFERED": "1"}, text=True, start_new_session=True,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, pipesize=PIPE,
    )  # fmt: skip


# Forks processes that have imported all that a training needs, and have done nothing yet: the imports take seconds.
WARM = multiprocessing.get_context("forkserver")
WARM.set_forkserver_preload(["nte.training.loop", "lightning_fabric", __name__])


class Forked:
    """`nte train CONFIG.yaml key=value …` in a process group of its own; all that it says is on `stdout`.

    file_size: bytes beyond which none of its files can grow.
    """

    def __init__(self, path: Path, *overrides: str, file_size: int | None = None) -> None:
        reader, writer = WARM.Pipe(duplex=False)
        fcntl.fcntl(writer.fileno(), fcntl.F_SETPIPE_SZ, PIPE)
        arguments = ["train", str(path), *overrides, "--device", "cpu"]
        self._process = WARM.Process(target=_told, args=(writer, arguments, file_size))
        self._process.start()
        writer.close()
        self.stdout = os.fdopen(os.dup(reader.fileno()))

    @property
    def pid(self) -> int:
        assert self._process.pid is not None
        return self._process.pid

    @property
    def returncode(self) -> int | None:
        return self._process.exitcode

    def wait(self) -> str:
        """Wait for the end; returns what it still says."""
        with self.stdout:
            said = self.stdout.read()
        self._process.join()
        return said


def _told(writer: Connection, arguments: list[str], file_size: int | None) -> None:
    os.setsid()
    for number in (1, 2):
        os.dup2(writer.fileno(), number)
    writer.close()
    sys.stdout.reconfigure(line_buffering=True)  # type: ignore[union-attr]
    if file_size is not None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (file_size, file_size))
    sys.exit(main(arguments))


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


@contextmanager
def interrupted_after(step: int, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A block in which Ctrl-C is pressed once, during this step of a training."""
    asked = iter([False] * (step - 1) + [True])
    with monkeypatch.context() as patched:
        patched.setattr("nte.interrupt.InterruptFlag.__enter__", lambda flag: lambda: next(asked))
        patched.setattr("nte.interrupt.InterruptFlag.__exit__", lambda flag, *error: None)
        yield
