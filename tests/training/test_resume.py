"""Killed at any moment, interrupted, resumed: the run ends as if nothing had happened. With real processes."""

import os
import random
import signal
import subprocess
import time
from pathlib import Path

import pytest

from nte.training.config import load_train_config
from nte.training.loop import train
from tests.conftest import Rounds
from tests.training.runs import Forked, assert_same_run, checkpoint, config_file, metrics, start, tiny_config

pytestmark = pytest.mark.slow
LONG = "phases=[{steps: 40}, {steps: 40, occlusion: 0.5}]"


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory, noisy_disc: Path) -> Path:
    """A run of 80 steps in this process, which is also one with a history. Only to be read."""
    return train(tiny_config(tmp_path_factory.mktemp("undisturbed"), noisy_disc, LONG), device="cpu")


def wait_for_step(process: "Forked | subprocess.Popen[str]", step: int) -> None:
    """Return when the process says that it has done a step."""
    assert process.stdout is not None
    for line in process.stdout:
        if line.startswith(f"step {step}:"):
            return
    raise AssertionError(f"ended before step {step}")


def stop(process: Forked, number: signal.Signals) -> str:
    """Send a signal to the process and its workers; returns what it still says."""
    os.killpg(process.pid, number)
    return process.wait()


def finish(path: Path, *overrides: str) -> None:
    """Resume to the end, in this process: it shares nothing with the one that was stopped."""
    train(load_train_config(path, [LONG, "resume=true", *overrides]), device="cpu")


def test_killed_at_random_moments_and_again_while_resuming(
    undisturbed: Path, tmp_path: Path, noisy_disc: Path, rounds: Rounds, moments: random.Random
) -> None:
    for number in range(rounds("killed trainings", 3, 51) // 3):
        folder = tmp_path / str(number)
        folder.mkdir()
        path, run = config_file(folder, noisy_disc), folder / "runs" / "tiny"
        process = Forked(path, LONG)
        wait_for_step(process, 1)  # before the first checkpoint
        stop(process, signal.SIGKILL)
        assert process.returncode == -signal.SIGKILL
        reached = 0
        for _ in range(2):
            process = Forked(path, LONG, "resume=true")
            # A step takes about 20 ms: the kill falls between steps, inside one, into a checkpoint or a validation.
            wait_for_step(process, reached + moments.randint(1, 8))
            time.sleep(moments.uniform(0, 0.05))
            stop(process, signal.SIGKILL)
            reached = int(str(checkpoint(run)["step"])) if (run / "checkpoint.safetensors").exists() else 0
            assert reached % 2 == 0
        finish(path)
        assert_same_run(run, undisturbed)
        assert not list(run.glob(".*"))


@pytest.mark.parametrize("loading", [pytest.param("data.workers=0", marks=pytest.mark.torture), "data.workers=2"])
def test_ctrl_c_stops_after_the_step_and_can_be_resumed(
    undisturbed: Path, tmp_path: Path, noisy_disc: Path, loading: str
) -> None:
    path, run = config_file(tmp_path, noisy_disc), tmp_path / "runs" / "tiny"
    process = start(path, LONG, loading, launcher=("-m", "nte", "train"))
    wait_for_step(process, 3)
    os.killpg(process.pid, signal.SIGINT)
    output, errors = process.communicate(timeout=300)
    assert process.returncode == 130, errors
    assert "Traceback" not in errors
    done = checkpoint(run)["step"]
    assert f"stopped after step {done} of 80; continue with resume=true" in output
    assert [line["step"] for line in metrics(run) if "loss" in line] == list(range(1, int(str(done)) + 1))
    finish(path, loading)
    assert_same_run(run, undisturbed)


def test_no_space_for_the_checkpoint_is_one_line(tmp_path: Path, noisy_disc: Path) -> None:
    # A file may not grow beyond 8 KiB: the same failure as a full disk, without one.
    process = Forked(config_file(tmp_path, noisy_disc), file_size=8192)
    errors = process.wait()
    assert process.returncode == 2, errors
    lines = [line for line in errors.splitlines() if line.startswith("nte:")]
    assert len(lines) == 1
    assert "checkpoint.safetensors: cannot be written" in lines[0]
    assert "Traceback" not in errors
    run = tmp_path / "runs" / "tiny"
    assert not [file for file in run.iterdir() if file.name.endswith(".tmp") or file.name.startswith("checkpoint")]
