"""Named parts of a denoiser's step: PyTorch's profiler shows them, and `nte bench --steps` says how long each takes."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import NamedTuple

from torch.profiler import record_function


class _Watch(NamedTuple):
    spent: dict[str, float]
    wait: Callable[[], object]


_WATCH: ContextVar[_Watch | None] = ContextVar("what times the scopes of this thread", default=None)


@contextmanager
def scope(name: str) -> Iterator[None]:
    """Call the work in the context by a name."""
    watch = _WATCH.get()
    with record_function(name):
        if watch is None:
            yield
            return
        watch.wait()
        watch.spent.setdefault(name, 0.0)  # in the order in which scopes begin
        begin = time.perf_counter()
        yield
        watch.wait()
        watch.spent[name] += time.perf_counter() - begin


@contextmanager
def timed_scopes(wait: Callable[[], object]) -> Iterator[dict[str, float]]:
    """Collect the seconds in each scope that begins in the context, on this thread: name → sum.

    In place of the profiler, whose own time would be in the small steps, and which knows the work of a device only by
    the kernels that it runs. wait: returns when the device has done all its work.
    """
    spent: dict[str, float] = {}
    token = _WATCH.set(_Watch(spent, wait))
    try:
        yield spent
    finally:
        _WATCH.reset(token)
