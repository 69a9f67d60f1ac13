"""Batches are loaded ahead by a thread, which ends with the loader whatever happens, and changes nothing else."""

import threading
from collections.abc import Callable, Iterator
from contextlib import closing
from itertools import islice

import pytest
import torch

from nte.errors import NteError
from nte.training.config import DataConfig
from nte.training.data import AHEAD, training_loader
from tests.training.conftest import loading_threads

SOON = 60.0  # seconds, on however busy a machine


class Numbered:
    """Batches that are their own numbers. meets: what happens while one of them is loaded."""

    def __init__(self, meets: Callable[[int], object] = lambda number: None) -> None:
        self.config, self.meets = DataConfig(clips=["."]), meets
        self.begun: list[int] = []
        self.loaded: list[int] = []
        self.threads: set[threading.Thread] = set()
        self.news = threading.Condition()

    def __getitem__(self, number: int) -> object:
        self.threads.add(threading.current_thread())
        with self.news:
            self.begun.append(number)
            self.news.notify_all()
        made = self.meets(number)
        with self.news:
            self.loaded.append(number)
            self.news.notify_all()
        return number if made is None else made

    def have(self, count: int) -> bool:
        """Wait until so many have been loaded."""
        with self.news:
            return self.news.wait_for(lambda: len(self.loaded) >= count, SOON)

    def has_begun(self, number: int) -> bool:
        """Wait until this one is being loaded."""
        with self.news:
            return self.news.wait_for(lambda: number in self.begun, SOON)


def fails_at(number: int, error: BaseException) -> Callable[[int], None]:
    def meets(now: int) -> None:
        if now == number:
            raise error

    return meets


@pytest.fixture
def gate() -> Iterator[threading.Event]:
    """Opened at the latest when the test ends, so that no thread waits for it forever."""
    opened = threading.Event()
    yield opened
    opened.set()


def test_the_next_batches_are_loaded_while_one_is_trained_on() -> None:
    data = Numbered()
    with closing(training_loader(data, 5, 50)) as loader:
        assert next(loader) == 5
        assert data.have(1 + AHEAD)
        assert data.loaded == [5, 6, 7]  # and no more, as none is asked for
        assert next(loader) == 6
        assert data.have(2 + AHEAD)
        assert loading_threads() == [*data.threads]
        assert threading.current_thread() not in data.threads
    assert data.loaded == [5, 6, 7, 8]


def test_all_batches_come_in_order_from_one_thread_that_ends_with_them() -> None:
    data = Numbered()
    assert list(training_loader(data, 3, 40)) == data.begun == [*range(3, 40)]
    assert len(data.threads) == 1
    assert not loading_threads()


def test_what_was_loaded_and_not_trained_on_is_loaded_again() -> None:
    first, then = Numbered(), Numbered()
    with closing(training_loader(first, 0, 20)) as loader:
        trained = [*islice(loader, 4)]
        assert first.have(4 + AHEAD)
    assert [*trained, *training_loader(then, len(trained), 20)] == [*range(20)]
    assert then.begun[0] == 4


@pytest.mark.parametrize("error", [MemoryError("too large"), NteError("a mistake"), SystemExit(3)])
def test_an_error_in_the_thread_is_raised_as_it_is_when_its_batch_is_due(error: BaseException) -> None:
    loader = training_loader(Numbered(fails_at(2, error)), 0, 9)
    assert [next(loader), next(loader)] == [0, 1]
    with pytest.raises(type(error)) as raised:
        next(loader)
    assert raised.value is error
    assert raised.traceback[-1].name == "meets"  # its traceback ends where it happened
    assert not loading_threads()


def test_a_faulty_file_is_told_when_its_batch_is_due() -> None:
    fault = NteError("frame_0002.exr: truncated")
    loader = training_loader(Numbered(lambda number: fault if number == 1 else None), 0, 9)
    assert next(loader) == 0
    with pytest.raises(NteError, match=r"frame_0002.exr: truncated"):
        next(loader)
    assert not loading_threads()


def test_closing_waits_for_the_batch_that_is_being_loaded_and_begins_no_other(gate: threading.Event) -> None:
    data = Numbered(lambda number: None if number != 1 or gate.wait(SOON) else "too late")
    loader = training_loader(data, 0, 9)
    assert next(loader) == 0
    assert data.has_begun(1)
    closer = threading.Thread(target=loader.close)
    closer.start()
    closer.join(0.05)
    assert closer.is_alive()  # else a cache could be deleted under the thread that writes it
    gate.set()
    closer.join(SOON)
    assert not closer.is_alive()
    assert not loading_threads()
    assert data.begun == data.loaded == [0, 1]


def test_an_interrupted_loader_leaves_no_thread() -> None:
    loader = training_loader(Numbered(), 0, 9)
    next(loader)
    with pytest.raises(KeyboardInterrupt):
        loader.throw(KeyboardInterrupt())
    assert not loading_threads()


def test_a_loader_without_batches_starts_no_thread() -> None:
    data = Numbered()
    with closing(training_loader(data, 8, 8)) as loader:
        assert not list(loader)
    assert not data.threads


def test_without_a_thread_each_batch_is_loaded_when_it_is_due() -> None:
    data = Numbered(fails_at(2, NteError("a mistake")))
    loader = training_loader(data, 0, 9, ahead=False)
    assert [next(loader), data.begun, next(loader), data.begun] == [0, [0, 1], 1, [0, 1]]
    assert data.threads == {threading.current_thread()}
    with pytest.raises(NteError, match="a mistake"):
        next(loader)


def test_pytorch_computes_on_one_core_in_the_thread_and_on_as_many_as_before_outside() -> None:
    before, inside = torch.get_num_threads(), []
    with closing(training_loader(Numbered(lambda number: inside.append(torch.get_num_threads())), 0, 3)) as loader:
        assert list(loader) == [0, 1, 2]
    assert inside == [1, 1, 1]
    assert torch.get_num_threads() == before
