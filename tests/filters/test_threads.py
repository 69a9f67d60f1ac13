"""Work shared among threads: all of it done, in the caller's modes, with nothing left changed."""

import threading
from collections.abc import Iterator

import pytest
import torch

from nte.filters.threads import own_threads, side_by_side, threads_for


@pytest.fixture(autouse=True)
def two_threads() -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    yield
    torch.set_num_threads(before)


def test_tasks_run_at_the_same_time_each_with_one_thread_and_the_number_comes_back() -> None:
    both = threading.Barrier(2, timeout=10)  # passed only if two are there at once
    found: list[int] = []

    def task() -> None:
        both.wait()
        found.append(torch.get_num_threads())

    side_by_side([task, task], threads=2)
    assert found == [1, 1]
    assert torch.get_num_threads() == 2


def test_within_own_threads_operations_have_one_and_shared_work_has_all() -> None:
    tensor = torch.zeros(1)
    with own_threads():
        assert torch.get_num_threads() == 1
        assert threads_for(tensor) == 2
        with own_threads():
            assert threads_for(tensor) == 2
        with pytest.raises(ZeroDivisionError), own_threads():
            raise ZeroDivisionError
        assert torch.get_num_threads() == 1
    assert torch.get_num_threads() == 2
    assert threads_for(tensor) == 2


def test_where_autograd_records_and_on_a_device_work_is_not_shared() -> None:
    recorded = torch.zeros(1, requires_grad=True)
    assert threads_for(recorded) == 1
    with torch.no_grad():
        assert threads_for(recorded) == 2
    assert threads_for(torch.zeros(1, device="meta")) == 1


@pytest.mark.parametrize("threads", [1, 2])
def test_an_error_in_a_task_is_raised_and_the_number_of_threads_comes_back(threads: int) -> None:
    done: list[int] = []

    def fail() -> None:
        raise KeyError("lost")

    with pytest.raises(KeyError, match="lost"):
        side_by_side([lambda: done.append(1), fail], threads)
    assert done == [1]
    assert torch.get_num_threads() == 2


@pytest.mark.parametrize("mode", [torch.no_grad, torch.inference_mode, torch.enable_grad])
def test_tasks_have_the_modes_of_the_caller(mode: type) -> None:
    found: list[tuple[bool, bool]] = []

    def task() -> None:
        found.append((torch.is_grad_enabled(), torch.is_inference_mode_enabled()))

    with mode():
        task()
        side_by_side([task, task], threads=2)
    assert found[1:] == found[:1] * 2
