"""Overlap of the stages of work on a sequence: threads make the next item and write the last one meanwhile."""

import os
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from itertools import islice
from typing import TypeVar

Item = TypeVar("Item")
Made = TypeVar("Made")


def ahead(items: Iterable[Item], count: int = 1, begin: Callable[[], object] = lambda: None) -> Generator[Item]:
    """Yield `items`; a thread makes the next `count` of them while the caller works on the one before.

    begin: called once in that thread. An error is raised when its item is due. So many items more than otherwise are in
    memory. Closing the generator ends the thread, after the item that it is making.
    """
    iterator = iter(items)
    with ThreadPoolExecutor(1, "ahead", begin) as thread:

        def begun(number: int) -> list[Future[list[Item]]]:
            return [thread.submit(lambda: list(islice(iterator, 1))) for _ in range(number)]

        coming = deque(begun(count))
        try:
            while found := coming.popleft().result():
                coming += begun(1)
                yield from found
        finally:
            thread.shutdown(cancel_futures=True)


def behind(work: Callable[[Item], Made], items: Iterable[Item]) -> Iterator[Made]:
    """Yield work(item) of each item, in order; a thread works on it while the next item is made.

    An item whose successor raises is finished first. An error of `work` is raised before the item after the next is
    made. One item more than otherwise is in memory.
    """
    working: Future[Made] | None = None
    with ThreadPoolExecutor(1, "behind") as thread:
        for item in items:
            if working:
                yield working.result()
            working = thread.submit(work, item)
        if working:
            yield working.result()


def sleep_while_waiting() -> None:
    """Let PyTorch's threads sleep while they wait for each other, so that stages beside them have the cores.

    By default OpenMP's threads keep their cores busy for some milliseconds after each operation. Sets OMP_WAIT_POLICY,
    unless the user has; OpenMP reads it once, when PyTorch is loaded, so later calls change nothing in this process.
    """
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
