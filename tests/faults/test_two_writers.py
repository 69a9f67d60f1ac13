"""Two commands that write to one place at a time: the second is refused in a line, the first one's work is whole."""

import os
import re
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from multiprocessing.connection import Connection
from pathlib import Path

import pytest

from nte.cli import main
from nte.runtime import trial
from tests.conftest import Rounds
from tests.faults.commands import COMMANDS, command, contents, differing
from tests.faults.watched import WARM, watched

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore::nte.motion.correspondence.FewerLevelsWarning")]
SECONDS = 300  # for a command to come to the moment at which it stands still, or to its end
REFUSED = re.compile(r"nte: .*: another process is writing (to )?it: wait for it, or choose another (folder|name)")


def standing(arguments: Sequence[str], folder: str, moment: int, ours: Connection) -> None:
    """Run a command that stands still before it puts its file number `moment` (from 1) in or below `folder`.

    ours: gets True then, and must be sent a word to go on; at the end it gets how many files there were.
    """
    placed, lock = 0, threading.Lock()

    def audit(event: str, details: tuple[object, ...]) -> None:
        nonlocal placed
        if event == "os.rename" and os.fsdecode(details[1]).startswith(folder):
            with lock:
                placed += 1
                here = placed == moment
            if here:
                ours.send(True)
                ours.recv()

    code = watched(arguments, audit)
    ours.send(placed)
    sys.exit(code)


@contextmanager
def standing_still(arguments: Sequence[str], folder: Path, moment: int) -> Iterator[None]:
    """A block in which a command has begun and stands still; then it goes on, and must end well."""
    theirs, ours = WARM.Pipe()
    process = WARM.Process(target=standing, args=(arguments, str(folder), moment, ours))
    process.start()
    ours.close()
    try:
        assert theirs.poll(SECONDS)
        assert theirs.recv() is True
        yield
        theirs.send(True)
        process.join(SECONDS)
        assert process.exitcode == 0
    finally:
        process.kill()
        process.join()


def files_placed(arguments: Sequence[str], folder: Path) -> int:
    """Run a command to its end, and return how many files it puts in or below `folder`."""
    theirs, ours = WARM.Pipe()
    process = WARM.Process(target=standing, args=(arguments, str(folder), sys.maxsize, ours))
    process.start()
    ours.close()
    assert theirs.poll(SECONDS)
    count: int = theirs.recv()
    process.join()
    assert process.exitcode == 0
    return count


def refusal(arguments: Sequence[str], capfd: pytest.CaptureFixture[str]) -> str:
    """Run a command that ends with status 2, and return the line that it says."""
    capfd.readouterr()
    assert main(arguments) == 2
    lines = [line for line in capfd.readouterr().err.splitlines() if line.startswith("nte: ")]
    (line,) = [line for line in lines if not line.startswith("nte: warning")]
    return line


@pytest.mark.parametrize("name", COMMANDS)
def test_the_second_is_refused_while_the_first_writes(
    name: str, noisy_disc: Path, run: Path, tmp_path: Path, rounds: Rounds, capfd: pytest.CaptureFixture[str]
) -> None:
    def words(out: Path) -> list[str]:
        return command(name, out, noisy_disc, run, tmp_path)

    undisturbed = tmp_path / "undisturbed"
    count = files_placed(words(undisturbed), undisturbed)
    expected = contents(undisturbed)
    tried = rounds("second writers", 1, 10)
    for number in range(tried):
        out = tmp_path / f"out {number}"
        with standing_still(words(out), out, 1 + int(count * (number + 0.5) / tried)):
            before = contents(out)
            for more in ([], ["--force"]):
                assert REFUSED.fullmatch(refusal([*words(out), *more], capfd))
            assert not differing(contents(out), before)
        assert not differing(contents(out), expected)


@pytest.mark.parametrize(("first", "second"), [("import", "denoise"), ("denoise", "import"), ("evaluate", "view")])
def test_another_command_is_refused_too(
    first: str, second: str, noisy_disc: Path, run: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"

    def words(name: str) -> list[str]:
        return [word.replace("out/clip", "out") for word in command(name, out, noisy_disc, run, tmp_path)]

    with standing_still(words(first), tmp_path, 2):
        line = refusal([*words(second), "--force"], capfd)
        assert REFUSED.fullmatch(line) or "is not a clip, so --force does not replace it" in line
    assert not (out / "frame_0000.png").exists() or first == "denoise"


def told(arguments: Sequence[str], said: str) -> None:
    """Run a command, and write what it says to a file."""
    trial.CHECK_FRAMES = 2
    with open(said, "w") as file:
        sys.stdout = sys.stderr = file
        code = main(arguments)
    sys.exit(code)


@pytest.mark.parametrize("name", COMMANDS)
def test_of_two_that_start_at_once_one_writes(
    name: str, noisy_disc: Path, run: Path, tmp_path: Path, rounds: Rounds
) -> None:
    """The other is refused, or comes too late and replaces nothing. Two that see each other may both be refused."""
    undisturbed = tmp_path / "undisturbed"
    files_placed(command(name, undisturbed, noisy_disc, run, tmp_path), undisturbed)
    expected = contents(undisturbed)
    for number in range(rounds("starts of two at once", 1, 20)):
        out = tmp_path / f"out {number}"
        words = command(name, out, noisy_disc, run, tmp_path)
        said = [tmp_path / f"said {number} {one}" for one in range(2)]
        both = [WARM.Process(target=told, args=(words, str(file))) for file in said]
        for process in both:
            process.start()
        for process, file in zip(both, said, strict=True):
            process.join(SECONDS)
            lines = [line for line in file.read_text().splitlines() if line.startswith("nte: ")]
            lines = [line for line in lines if not line.startswith("nte: warning")]
            assert process.exitcode == (2 if lines else 0), file.read_text()
            assert len(lines) < 2
        if all(process.exitcode for process in both):
            assert contents(out) == {}
            assert main(words) == 0
        assert not differing(contents(out), expected)
