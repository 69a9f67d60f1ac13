"""Overlap of the stages of work on a sequence: threads make the next item and write the last one meanwhile."""

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from itertools import islice
from typing import TypeVar

Item = TypeVar("Item")
Made = TypeVar("Made")


def ahead(items: Iterable[Item]) -> Iterator[Item]:
    """Yield `items`; a thread makes the next one while the caller works on the one before.

    An error is raised when its item is due. One item more than otherwise is in memory.
    """
    iterator = iter(items)
    with ThreadPoolExecutor(1, "ahead") as thread:

        def begun() -> Future[list[Item]]:
            return thread.submit(lambda: list(islice(iterator, 1)))

        coming = begun()
        while found := coming.result():
            coming = begun()
            yield from found


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
