"""Commands that are killed at any moment: started again, they end as if nothing had happened, and leave nothing else.

What a killed process leaves in a folder changes only when it opens, renames or removes a file there. So it is killed
before such an operation: the first, and some later ones.
"""

import os
import random
import signal
import sys
from collections.abc import Sequence
from multiprocessing.connection import Connection
from pathlib import Path

import pytest

from tests.conftest import Rounds
from tests.faults.commands import COMMANDS, command, contents, differing
from tests.faults.watched import WARM, watched

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore::nte.motion.correspondence.FewerLevelsWarning")]
OPERATIONS = ("open", "os.rename", "os.remove", "os.rmdir", "os.mkdir", "os.scandir")


def dying(arguments: Sequence[str], folder: str, moment: int, tell: Connection) -> None:
    """Run a command, and kill this process before its operation number `moment` (from 1) in or below `folder`.

    tell: gets the number of operations, if there are fewer.
    """
    done = 0

    def audit(event: str, details: tuple[object, ...]) -> None:
        nonlocal done
        if event in OPERATIONS and isinstance(details[0], str | bytes | os.PathLike):
            done += os.fsdecode(details[0]).startswith(folder)
            if done == moment:
                os.kill(os.getpid(), signal.SIGKILL)

    code = watched(arguments, audit)
    tell.send(done)
    sys.exit(code)


def begun(arguments: Sequence[str], folder: Path, moment: int) -> tuple[int | None, Connection]:
    """Run a command to its end or death, and return its exit code, and what it tells."""
    told, tell = WARM.Pipe(duplex=False)
    process = WARM.Process(target=dying, args=(arguments, str(folder), moment, tell))
    process.start()
    tell.close()
    process.join()
    return process.exitcode, told


def killed(arguments: Sequence[str], folder: Path, moment: int) -> bool:
    """Tell whether a command was killed before an operation; otherwise it has ended well, with fewer of them."""
    code, _ = begun(arguments, folder, moment)
    assert code in (0, -signal.SIGKILL)
    return code != 0


def operations(arguments: Sequence[str], folder: Path) -> int:
    """Run a command to its end, and return how many operations it does in or below `folder`."""
    code, told = begun(arguments, folder, sys.maxsize)
    assert code == 0
    count: int = told.recv()
    return count


# Operations of each command before which it is killed every day; torture draws more of them, and kills the others too:
# they take long, and are killed every day in test_killed_cluster.py (render) and in training/test_resume.py (train).
MOMENTS = {
    "compare": (9, 19, 30), "denoise": (1, 14, 27), "loose frames": (9, 17), "estimate": (4, 12, 23),
    "evaluate": (4, 8, 12), "export": (9,), "import": (8,), "merge-burst": (7,), "view": (11,),
}  # fmt: skip
OFTEN = {"render": 50}  # kills in torture, where it is not 10


@pytest.mark.parametrize(
    "name", [name if name in MOMENTS else pytest.param(name, marks=pytest.mark.torture) for name in COMMANDS]
)
def test_it_is_started_again_and_ends_as_undisturbed(
    name: str, noisy_disc: Path, run: Path, tmp_path: Path, rounds: Rounds, moments: random.Random
) -> None:
    def arguments(out: Path) -> list[str]:
        return command(name, out, noisy_disc, run, tmp_path)

    undisturbed, daily = tmp_path / "undisturbed", MOMENTS.get(name, ())
    count = operations(arguments(undisturbed), undisturbed)
    expected = contents(undisturbed)
    more = rounds("kills", len(daily), OFTEN.get(name, 10)) - len(daily)
    for number, moment in enumerate((*daily, *(moments.randint(1, count) for _ in range(more)))):
        out = tmp_path / f"killed at {moment} {number}"
        assert killed(arguments(out), out, moment)
        if moment in daily:
            assert contents(out) != expected  # otherwise it was killed too late: choose another moment
        there = contents(out)
        was_done = {name: there[name] for name in there if not name.endswith(".tmp")} == expected  # nothing is replaced
        code, _ = begun(arguments(out), out, sys.maxsize)
        assert not differing(contents(out), expected), moment
        assert code == 0 or (code == 2 and was_done), moment
