"""Strips of an image on several threads of the CPU: each runs its many small operations by itself.

PyTorch spreads one operation over threads, which then wait for each other; after thousands of operations of some
microseconds that waiting is what takes the time, all the more where the machine has other work to do.
"""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import ContextVar

import torch
from torch import Tensor

_SHARED: ContextVar[int] = ContextVar("threads that side_by_side may use", default=1)


@contextmanager
def own_threads() -> Iterator[None]:
    """Within, PyTorch's operations run on the calling thread, and `side_by_side` has the threads they had."""
    before = torch.get_num_threads()
    token = _SHARED.set(max(before, _SHARED.get()))
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
        _SHARED.reset(token)


def threads_for(tensor: Tensor) -> int:
    """How many threads may share work on a tensor; one where autograd records, and on another device."""
    recorded = torch.is_grad_enabled() and tensor.requires_grad
    return 1 if recorded or tensor.device.type != "cpu" else max(_SHARED.get(), torch.get_num_threads())


def side_by_side(tasks: Sequence[Callable[[], None]], threads: int) -> None:
    """Run the tasks, which must not write where another reads or writes; returns when all are done.

    threads: as `threads_for` says. Whatever a task raises is raised here.
    """
    threads = min(threads, len(tasks))
    if threads < 2:
        for task in tasks:
            task()
        return
    recording, inference = torch.is_grad_enabled(), torch.is_inference_mode_enabled()

    def run(task: Callable[[], None]) -> None:
        # These modes belong to a thread, and a new one starts with the defaults.
        with torch.inference_mode(inference), torch.set_grad_enabled(recording and not inference):
            task()

    with own_threads(), ThreadPoolExecutor(threads) as pool:  # new threads have as many as this one: 1
        for future in [pool.submit(run, task) for task in tasks]:
            future.result()
