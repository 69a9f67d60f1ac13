"""Parallel work on strips of an image: several CPU threads, each of which runs many small operations by itself.

PyTorch spreads single operations over threads, which then wait for each other. For thousands of operations of a few
microseconds this waiting dominates, most of all on a machine that has other work to do.
"""

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import ContextVar

import torch
from torch import Tensor

_SHARED: ContextVar[int] = ContextVar("threads that side_by_side may use", default=1)


def limit_threads(count: int) -> None:
    """Let filters compute on `count` CPU threads in this process from now on: those of PyTorch, and OIDN.

    OIDN counts its threads once, when its first image is denoised.
    """
    torch.set_num_threads(count)
    os.environ["OIDN_NUM_THREADS"] = str(count)


@contextmanager
def own_threads() -> Iterator[None]:
    """Run PyTorch's operations within the context on the calling thread, and leave their threads to `side_by_side`."""
    before = torch.get_num_threads()
    token = _SHARED.set(max(before, _SHARED.get()))
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
        _SHARED.reset(token)


def threads_for(tensor: Tensor) -> int:
    """Return how many threads may share work on a tensor: 1 where autograd records or the device is not the CPU."""
    recorded = torch.is_grad_enabled() and tensor.requires_grad
    return 1 if recorded or tensor.device.type != "cpu" else max(_SHARED.get(), torch.get_num_threads())


def side_by_side(tasks: Sequence[Callable[[], None]], threads: int) -> None:
    """Run the tasks, in parallel if threads > 1, and return when all are done.

    No task may write where another reads or writes. threads: from `threads_for`. Raises what a task raises.
    """
    threads = min(threads, len(tasks))
    if threads < 2:
        for task in tasks:
            task()
        return
    recording, inference = torch.is_grad_enabled(), torch.is_inference_mode_enabled()

    def run(task: Callable[[], None]) -> None:
        # Autograd modes are per thread, and a new thread starts with the defaults.
        with torch.inference_mode(inference), torch.set_grad_enabled(recording and not inference):
            task()

    with own_threads(), ThreadPoolExecutor(threads) as pool:  # new threads inherit the limit of one PyTorch thread
        for future in [pool.submit(run, task) for task in tasks]:
            future.result()
