"""Work in other processes: every unit once, and no result in memory for longer than its receiver keeps it."""

from weakref import ref

import numpy as np
import numpy.typing as npt
import pytest

from nte.errors import NteError
from nte.jobs import Kind, in_processes
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
