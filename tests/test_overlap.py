"""Reading ahead and writing behind: the order is kept, the stages run at the same time, and errors come when due."""

import os
import re
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from nte.overlap import ahead, behind

SOON = 20.0  # seconds; a stage that waits for another in vain fails then


def test_ahead_yields_all_in_order_while_it_makes_the_next_one() -> None:
    begun = [threading.Event() for _ in range(5)]

    def items() -> Iterator[int]:
        for number, event in enumerate(begun):
            event.set()
            yield number

    seen = []
    for item in ahead(items()):
        if item + 1 < len(begun):
            assert begun[item + 1].wait(SOON)
        seen.append(item)
    assert seen == [0, 1, 2, 3, 4]
    assert list(ahead([])) == []
    assert list(ahead([None, 0, []])) == [None, 0, []]  # what is false is no end


def test_ahead_makes_no_more_than_one_item_too_early() -> None:
    made: list[int] = []
    items = ahead(made.append(i) or i for i in range(9))  # type: ignore[func-returns-value]
    assert next(items) == 0
    items.close()  # type: ignore[attr-defined]  # waits for the thread
    assert made in ([0], [0, 1])  # one that had not begun is left out


def test_behind_works_on_an_item_while_the_next_one_is_made() -> None:
    made = [threading.Event() for _ in range(4)]

    def items() -> Iterator[int]:
        for number, event in enumerate(made):
            event.set()
            yield number

    def work(item: int) -> int:
        assert item + 1 == len(made) or made[item + 1].wait(SOON)
        return item * item

    assert list(behind(work, items())) == [0, 1, 4, 9]
    assert list(behind(work, [])) == []


def test_an_error_of_a_stage_comes_after_what_is_before_it() -> None:
    def items() -> Iterator[int]:
        yield from range(3)
        raise ValueError("fourth")

    seen: list[int] = []
    with pytest.raises(ValueError, match="fourth"):
        seen.extend(ahead(items()))
    assert seen == [0, 1, 2]
    worked: list[int] = []
    with pytest.raises(ValueError, match="fourth"):
        list(behind(worked.append, items()))
    assert worked == [0, 1, 2]  # the last one is finished, although its successor failed

    def work(item: int) -> None:
        if item == 1:
            raise OSError("full")
        worked.append(item)

    worked.clear()
    made: list[int] = []
    with pytest.raises(OSError, match="full"):
        list(behind(work, (made.append(i) or i for i in range(9))))  # type: ignore[func-returns-value]
    assert worked == [0]
    assert made == [0, 1, 2]  # not the rest


@pytest.mark.slow
def test_threads_of_pytorch_sleep_while_files_are_read_and_written(noisy_disc: Path, tmp_path: Path) -> None:
    """OpenMP tells how it waits when it is loaded; what the user has chosen stays."""
    code = "import sys; from nte.cli import main; sys.exit(main(sys.argv[1:]))"
    command = [sys.executable, "-c", code, "denoise", noisy_disc, "--denoiser", "taa", "--out"]
    without = {name: value for name, value in os.environ.items() if name != "OMP_WAIT_POLICY"}
    for chosen, policy in (({}, "PASSIVE"), ({"OMP_WAIT_POLICY": "ACTIVE"}, "ACTIVE")):
        told = without | chosen | {"OMP_DISPLAY_ENV": "TRUE"}
        done = subprocess.run([*command, tmp_path / policy], env=told, capture_output=True, text=True, check=True)
        assert re.search(rf"OMP_WAIT_POLICY ?= ?'{policy}'", done.stderr), done.stderr
