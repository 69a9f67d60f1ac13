"""Commands that are killed at any moment: started again, they end as if nothing had happened, and leave nothing else.

What a killed process leaves in a folder changes only when it opens, renames or removes a file there. So it is killed
before such an operation: the first, and some later ones.
"""

import json
import multiprocessing
import os
import signal
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

from nte.cli import main
from nte.runtime import export
from nte.training.run import load_run
from tests.shared import made_once
from tests.training.runs import tiny_config

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore::nte.motion.correspondence.FewerLevelsWarning")]
OPERATIONS = ("open", "os.rename", "os.remove", "os.rmdir", "os.mkdir", "os.scandir")
# Forks processes that have imported what the commands need, and have started no thread yet.
WARM = multiprocessing.get_context("forkserver")
WARM.set_forkserver_preload(
    [f"nte.{name}" for name in ("evaluation.evaluate", "estimation", "filters.taa", "runtime.export", "sequences")]
    + ["nte.training.run", "onnxscript", "flip_evaluator", "PIL.Image", "matplotlib.pyplot", __name__]
)


def dying(arguments: Sequence[str], folder: str, moment: int) -> None:
    """Run a command, and kill this process before its operation number `moment` (from 1) in or below `folder`."""
    done = 0

    def audit(event: str, details: tuple[object, ...]) -> None:
        nonlocal done
        if event in OPERATIONS and isinstance(details[0], str | bytes | os.PathLike):
            done += os.fsdecode(details[0]).startswith(folder)
            if done == moment:
                os.kill(os.getpid(), signal.SIGKILL)

    export.CHECK_FRAMES = 2  # the check takes long, and changes no file
    with open(os.devnull, "w") as nowhere:
        sys.stdout = sys.stderr = nowhere
        sys.addaudithook(audit)
        code = main(arguments)
    sys.exit(code)


def killed(arguments: Sequence[str], folder: Path, moment: int) -> bool:
    """Tell whether a command was killed before an operation; otherwise it has ended well, with fewer of them."""
    process = WARM.Process(target=dying, args=(arguments, str(folder), moment))
    process.start()
    process.join()
    assert process.exitcode in (0, -signal.SIGKILL)
    return process.exitcode != 0


def contents(folder: Path) -> dict[str, bytes]:
    """All files below a folder; the times in an evaluation's results, which no two runs share, are left out."""
    found = {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    if "metrics.json" in found:
        rows = json.loads(found["metrics.json"])["rows"]
        kept = [{key: value for key, value in row.items() if "ms_per_frame" not in key} for row in rows]
        found |= {"metrics.json": json.dumps(kept).encode(), "index.html": b""}
    return found


@pytest.fixture(scope="session")
def run(noisy_disc: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run folder with a network of a few hundred weights."""

    def train_two_steps(folder: Path) -> None:
        from nte.training.loop import train

        train(tiny_config(folder, noisy_disc, "phases=[{steps: 2}]"), device="cpu")

    folder = made_once(tmp_path_factory, "killed_run", train_two_steps) / "runs" / "tiny"
    load_run(folder)
    return folder


COMMANDS = {
    "denoise": (["denoise", "CLIP", "--denoiser", "taa", "--png", "--out", "OUT"], (1, 14, 27)),
    "loose frames": (["denoise", "FRAMES", "--denoiser", "noisy", "--out", "OUT"], (9, 17)),
    "estimate": (["estimate", "CLIP", "--noise", "clean", "--out", "OUT"], (4, 12, 23)),
    "evaluate": (["evaluate", "--clips", "CLIP", "--denoisers", "noisy", "taa", "--out", "OUT"], (4, 8, 12)),
    "export": (["export", "RUN", "--out", "OUT/model.onnx"], (9,)),
}


@pytest.mark.parametrize("name", COMMANDS)
def test_it_is_started_again_and_ends_as_undisturbed(name: str, noisy_disc: Path, run: Path, tmp_path: Path) -> None:
    command, moments = COMMANDS[name]
    places = {"CLIP": noisy_disc, "RUN": run}
    frames = [str(path) for path in sorted(noisy_disc.glob("*.exr"))]

    def arguments(out: Path) -> list[str]:
        typed = [frames if word == "FRAMES" else [str(places.get(word, word))] for word in command]
        return [word.replace("OUT", str(out)) for words in typed for word in words]

    assert main(arguments(tmp_path / "undisturbed")) == 0
    expected = contents(tmp_path / "undisturbed")
    for moment in moments:
        out = tmp_path / f"killed at {moment}"
        assert killed(arguments(out), out, moment)
        assert contents(out) != expected  # otherwise it was killed too late: choose another moment
        assert not killed(arguments(out), out, sys.maxsize)
        assert contents(out) == expected, moment
