"""SIGTERM and Ctrl-C at any moment of a command: it ends in a line, and started again it ends as if undisturbed.

The commands are real processes, and the signals real ones.
"""

import random
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from nte.cli import INTERRUPTED, main
from tests.conftest import Rounds
from tests.faults.commands import COMMANDS, command, contents, differing
from tests.faults.interrupting import SENT

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore::nte.motion.correspondence.FewerLevelsWarning")]
BOUND = 60  # seconds within which a command ends, on a machine that has much else to do
ROOT = Path(__file__).parents[2]
SAID = "nte: interrupted; every file is whole or absent"


def ended(number: int, moment: int, delay: float, out: Path, words: list[str]) -> tuple[int, str, str]:
    """Run a command that gets a signal, and return its exit code, and what it says on stdout and stderr."""
    arguments = [str(number), str(moment), str(delay), str(out), *words]
    with subprocess.Popen(
        [sys.executable, "-m", "tests.faults.interrupting", *arguments],
        cwd=ROOT, text=True, start_new_session=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    ) as process:  # fmt: skip
        assert process.stdout is not None
        lines = []
        for line in process.stdout:
            lines.append(line)
            if line == f"{SENT}\n":
                break
        try:
            output, errors = process.communicate(timeout=BOUND)
        finally:
            process.kill()
        return process.returncode, "".join(lines) + output, errors


@pytest.mark.parametrize("name", COMMANDS)
def test_it_ends_in_a_line_and_is_started_again(
    name: str, noisy_disc: Path, run: Path, tmp_path: Path, rounds: Rounds
) -> None:
    def words(out: Path) -> list[str]:
        return command(name, out, noisy_disc, run, tmp_path)

    undisturbed = tmp_path / "undisturbed"
    code, output, errors = ended(0, 0, 0, undisturbed, words(undisturbed))
    assert code == 0, errors
    count, expected = int(output.split()[-1]), contents(undisturbed)
    for seed in range(rounds("interrupted commands", 2, 10)):
        rng = random.Random(f"{name} {seed}")
        number = (signal.SIGTERM, signal.SIGINT)[seed % 2]
        moment = rng.randint(1, count) if seed % 5 < 4 else 0
        delay = rng.uniform(0, 0.1) if moment else rng.uniform(0, 3)
        told = f"seed {seed}: {number.name} {delay:.3f} s after operation {moment} of {count}"
        out = tmp_path / f"out {seed}"
        code, output, errors = ended(number, moment, delay, out, words(out))
        lines = [line for line in errors.splitlines() if line.startswith("nte: ") and "warning: " not in line]
        assert "Traceback" not in errors, f"{told}\n{errors}"
        was_done = contents(out) == expected  # then nothing is replaced
        if was_done:  # a signal while Python itself ends is nothing that a command could tell
            assert code in (0, INTERRUPTED, -number), f"{told}\n{errors}"
        else:
            # `python -m` kills itself by SIGINT, shown by a shell as 130, if an exec of a text was interrupted.
            assert code in (INTERRUPTED, -signal.SIGINT), f"{told}\n{errors}"
            assert lines == [SAID], f"{told}\n{errors}"
        assert not [path for path in out.rglob("*") if path.suffix == ".tmp"], told
        assert main(words(out)) in ((0, 2) if was_done else (0,)), told
        assert not differing(contents(out), expected), told
