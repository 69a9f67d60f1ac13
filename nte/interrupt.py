"""Ctrl-C while something must be finished first, and SIGTERM in its place."""

import multiprocessing
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType, TracebackType
from typing import Any


class InterruptFlag:
    """Within the block the first Ctrl-C only sets a flag, so that a step ends whole; a second one interrupts."""

    def __enter__(self) -> "InterruptFlag":
        self._set = False
        self._before: Any = signal.signal(signal.SIGINT, self._handle)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        signal.signal(signal.SIGINT, self._before)

    def __call__(self) -> bool:
        """Whether Ctrl-C was pressed."""
        return self._set

    def _handle(self, number: int, frame: FrameType | None) -> None:
        if self._set:
            raise KeyboardInterrupt
        self._set = True


@contextmanager
def terminable() -> Iterator[None]:
    """Within the block SIGTERM, how batch systems and `kill` stop a process, does what Ctrl-C does.

    It does so also where InterruptFlag has changed what that is. Threads other than the main one change nothing.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGTERM, lambda number, frame: signal.raise_signal(signal.SIGINT))
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


@contextmanager
def ending_workers() -> Iterator[None]:
    """End the processes of a pool with the block, if it ends by an error or an interruption, instead of waiting.

    They must have called `end_when_told`.
    """
    try:
        yield
    except BaseException:
        for worker in multiprocessing.active_children():
            worker.terminate()
        raise


def end_when_told() -> None:
    """Let this process of a pool clean up and end at SIGTERM, and leave Ctrl-C to its parent, which sends that."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda number, frame: sys.exit(128 + number))
