"""Commands that are killed at any moment: started again, they end as if nothing had happened, and leave nothing else.

What a killed process leaves in a folder changes only when it opens, renames or removes a file there. So it is killed
before such an operation: the first, and some later ones.
"""

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
from tests.faults.commands import command, contents, make_run

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


MOMENTS = {
    "denoise": (1, 14, 27), "loose frames": (9, 17), "estimate": (4, 12, 23), "evaluate": (4, 8, 12), "export": (9,),
}  # fmt: skip


@pytest.fixture(scope="session")
def run(noisy_disc: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = make_run(noisy_disc, tmp_path_factory)
    load_run(folder)
    return folder


@pytest.mark.parametrize("name", MOMENTS)
def test_it_is_started_again_and_ends_as_undisturbed(name: str, noisy_disc: Path, run: Path, tmp_path: Path) -> None:
    def arguments(out: Path) -> list[str]:
        return command(name, out, noisy_disc, run, tmp_path)

    assert main(arguments(tmp_path / "undisturbed")) == 0
    expected = contents(tmp_path / "undisturbed")
    for moment in MOMENTS[name]:
        out = tmp_path / f"killed at {moment}"
        assert killed(arguments(out), out, moment)
        assert contents(out) != expected  # otherwise it was killed too late: choose another moment
        assert not killed(arguments(out), out, sys.maxsize)
        assert contents(out) == expected, moment
