"""Training on several processes: what one does with the same batch, one writer, and no process that waits forever."""

import os
import signal
import subprocess
import time
from pathlib import Path

import pytest
import torch

from nte.errors import NteError
from nte.training.loop import train
from tests.synthetic import disc_clip
from tests.training.runs import checkpoint, config_file, metrics, start, tiny_config

pytestmark = pytest.mark.slow
TORCHRUN = ("-m", "torch.distributed.run", "--standalone", "--nproc_per_node=2", "train.py")
WEIGHT = "denoiser.prediction.trunk.encoders.0.0.weight"


def test_two_processes_do_what_one_does_with_the_same_batch_and_one_of_them_writes(tmp_path: Path) -> None:
    for seed in range(4):
        start_at = (8.0 + 3 * seed, 12.0)
        disc_clip(tmp_path / "clips" / f"disc_{seed}", frames=4, seed=seed, size=(24, 40), start=start_at, radius=6.0)
    # Whole frames from the first on, as they are: what is drawn for a sequence depends on its process.
    same = ["data.crop=0", "data.augment=false", "data.any_start=false"]
    twenty = "phases=[{steps: 10}, {steps: 10, occlusion: 0.5}]"
    path = config_file(tmp_path, tmp_path / "clips")
    process = start(path, twenty, *same, "data.batch=1", launcher=TORCHRUN)
    output, errors = process.communicate(timeout=300)
    assert process.returncode == 0, errors
    run = tmp_path / "runs" / "tiny"
    assert [line["step"] for line in metrics(run) if "loss" in line] == list(range(1, 21))
    assert len(list(run.glob("events.*"))) == 1
    assert output.count("step 20: loss") == 1

    one = train(tiny_config(tmp_path, tmp_path / "clips", twenty, *same, "data.batch=2", "name=one"), device="cpu")
    ours, theirs = checkpoint(run), checkpoint(one)
    assert ours.pop("step") == theirs.pop("step") == "20"
    weights = [name for name in ours if name.startswith("denoiser.")]
    assert WEIGHT in weights
    for name in weights:
        torch.testing.assert_close(ours[name], theirs[name], rtol=1e-5, atol=1e-5)
    # Neither process alone would have come here.
    half = train(tiny_config(tmp_path, tmp_path / "clips", twenty, *same, "data.batch=1", "name=half"), device="cpu")
    assert (checkpoint(half)[WEIGHT] - ours[WEIGHT]).abs().max() > 1e-3
    with pytest.raises(NteError, match="trained by 2 processes, and here are 1, which changes what a step is"):
        train(tiny_config(tmp_path, tmp_path / "clips", twenty, *same, "data.batch=1", "resume=true"), device="cpu")


def told(rank: int) -> str:
    """The line that a process says when it has lost the other one."""
    return f"nte: process {rank} of 2, counted from 0: another one has ended, or has not answered for"


@pytest.mark.parametrize("victim", [0, 1])
def test_a_killed_process_ends_the_other_with_a_line(victim: int, tmp_path: Path, noisy_disc: Path) -> None:
    process = start(config_file(tmp_path, noisy_disc), "phases=[{steps: 100000}]", launcher=TORCHRUN)
    workers = children_at_step(process, 3)
    os.kill(workers[victim], signal.SIGKILL)
    began = time.monotonic()
    _, errors = process.communicate(timeout=120)
    assert time.monotonic() - began < 60
    assert process.returncode not in (0, None)
    lines = [line for line in errors.splitlines() if line.startswith("nte: ")]
    # torchrun stops the other one by SIGTERM, if it has not noticed by itself.
    assert len(lines) == 1, errors
    assert lines[0].startswith((told(1 - victim), "nte: interrupted"))
    assert "[rank" not in errors  # before the lines of an error that the other one has not caught
    assert "SIGKILL" in errors or "Signal 9" in errors  # torchrun says which of them was killed
    assert all(not Path(f"/proc/{worker}").exists() for worker in workers)
    assert int(str(checkpoint(tmp_path / "runs" / "tiny")["step"])) >= 2  # it can be resumed


def test_a_process_that_hangs_is_waited_for_in_bounded_time(tmp_path: Path, noisy_disc: Path) -> None:
    impatient = tmp_path / "impatient.py"
    impatient.write_text(
        "import sys\nfrom nte.cli import main\nfrom nte.training import processes\nprocesses.PATIENCE = 5\n"
        "sys.exit(main(['train', *sys.argv[1:]]))\n"
    )
    launcher = (*TORCHRUN[:-1], str(impatient))
    process = start(config_file(tmp_path, noisy_disc), "phases=[{steps: 100000}]", launcher=launcher)
    workers = children_at_step(process, 3)
    os.kill(workers[1], signal.SIGSTOP)
    assert process.stderr is not None
    began = time.monotonic()
    for line in process.stderr:
        if line.startswith("nte: "):
            break
    assert line.startswith(told(0))
    assert time.monotonic() - began < 60
    os.kill(workers[1], signal.SIGCONT)  # otherwise torchrun kills it half a minute later
    process.communicate(timeout=120)
    assert process.returncode not in (0, None)
    assert int(str(checkpoint(tmp_path / "runs" / "tiny")["step"])) >= 2


def children_at_step(process: "subprocess.Popen[str]", step: int) -> list[int]:
    """The processes of a training, by their rank, when it has done a step."""
    assert process.stdout is not None
    for line in process.stdout:
        if line.startswith(f"step {step}:"):
            break
    ranks = {}
    for worker in children(process.pid):
        words = Path(f"/proc/{worker}/environ").read_bytes().split(b"\0")
        ranks |= {int(word[5:]): worker for word in words if word.startswith(b"RANK=")}
    assert sorted(ranks) == [0, 1]
    return [ranks[0], ranks[1]]


def children(parent: int) -> list[int]:
    """The processes that a process has started, in their order."""
    listed = subprocess.run(["ps", "--ppid", str(parent), "-o", "pid="], capture_output=True, text=True, check=True)
    return [int(word) for word in listed.stdout.split()]
