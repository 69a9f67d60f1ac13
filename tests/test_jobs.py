"""Work in other processes: every unit once, and no result in memory for longer than its receiver keeps it."""

import os
import subprocess
import sys
import time
from pathlib import Path
from weakref import ref

import numpy as np
import numpy.typing as npt
import pytest

from nte.errors import NteError
from nte.jobs import Kind, in_processes, tick
from tests.conftest import Rounds

ALIVE = 6  # results that may be on their way at a time, with two processes


def share_nothing(jobs: int) -> None:
    pass


KIND = Kind("count", share_nothing, dict)


def filled(value: int) -> npt.NDArray[np.int64]:
    """A result of a megabyte."""
    if value < 0:
        raise NteError(f"{value}: expected a number from 0")
    return np.full(2**17, value)


@pytest.mark.slow
def test_results_are_not_kept() -> None:
    given: list[ref[npt.NDArray[np.int64]]] = []
    seen: dict[str, int] = {}
    most = 0

    def done(name: str, result: npt.NDArray[np.int64]) -> None:
        nonlocal most
        given.append(ref(result))
        most = max(most, sum(one() is not None for one in given))
        seen[name] = int(result[-1])

    units = {f"unit {number}": number for number in range(100)}
    in_processes(KIND, filled, units, 2, done)
    assert seen == units
    assert most <= ALIVE


def ticking(count: int) -> int:
    """A unit that tells each of its pieces."""
    for _ in range(count):
        tick()
    return count


@pytest.mark.slow
def test_what_units_tell_is_heard_before_they_end() -> None:
    told, finished, late = 0, 0, []

    def advance(count: int) -> None:
        nonlocal told
        told += count

    def done(name: str, result: int) -> None:
        nonlocal finished
        finished += result
        late.append(finished > told)

    units = {f"unit {number}": number for number in range(10)}
    in_processes(KIND, ticking, units, 2, done, advance)
    assert told == finished == sum(units.values())
    assert not any(late)
    assert tick() is None  # nobody listens to this process


@pytest.mark.slow
def test_a_faulty_unit_ends_the_work_with_its_own_error() -> None:
    seen: list[str] = []
    with pytest.raises(NteError, match="-1: expected a number from 0"):
        in_processes(KIND, filled, {str(n): n if n != 20 else -1 for n in range(1000)}, 2, lambda n, _: seen.append(n))
    assert len(seen) < 100


@pytest.mark.slow
def test_an_error_of_the_receiver_ends_the_work(rounds: Rounds) -> None:
    """Workers are then in the middle of a unit, or of sending a result: neither may make others wait."""

    def done(name: str, result: npt.NDArray[np.int64]) -> None:
        raise OSError(28, "No space left on device")

    for _ in range(rounds("failures of a receiver", 2, 100)):
        with pytest.raises(OSError, match="No space left"):
            in_processes(KIND, filled, {str(number): number for number in range(50)}, 2, done)


IMPATIENT = """
import os, signal, sys, time
from threading import Timer
from nte.jobs import in_processes
from tests.test_jobs import KIND, nap

def interrupt():
    for _ in range(int(sys.argv[1])):
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(0.05)

if __name__ == "__main__":
    units = {str(number): number for number in range(1000)}
    in_processes(KIND, nap, units, 2, lambda name, _: name == "3" and Timer(0, interrupt).start())
"""


def nap(value: int) -> int:
    """A unit that is long in code that no signal interrupts, as a renderer's is."""
    end = time.monotonic() + 0.5
    while time.monotonic() < end:
        np.sort(np.arange(2_000_000)[::-1])
    return value


@pytest.mark.slow
@pytest.mark.parametrize("times", [1, 2, 3])
def test_however_often_it_is_interrupted_it_ends(tmp_path: Path, times: int) -> None:
    """Who presses Ctrl-C twice is in a hurry; the processes then waited for each other forever."""
    script = tmp_path / "impatient.py"
    script.write_text(IMPATIENT)
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).parents[1])}
    ended = subprocess.run(
        [sys.executable, script, str(times)], env=environment, timeout=60, capture_output=True, check=False
    )
    assert b"KeyboardInterrupt" in ended.stderr
