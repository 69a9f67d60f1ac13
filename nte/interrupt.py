"""Handling of Ctrl-C and SIGTERM: a step that must end first, a process that must clean up, the workers of a pool."""

import multiprocessing
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType, TracebackType
from typing import Any


class InterruptFlag:
    """A block in which the first Ctrl-C only sets a flag, so that a step can end; a second one interrupts.

    Calling the object tells whether the flag is set. In a thread other than the main one, which gets no signals, the
    block changes nothing and the flag stays unset.
    """

    def __enter__(self) -> "InterruptFlag":
        self._set, self._handles = False, _gets_signals()
        if self._handles:
            self._before: Any = signal.signal(signal.SIGINT, self._handle)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._handles:
            signal.signal(signal.SIGINT, self._before)

    def __call__(self) -> bool:
        """Tell whether Ctrl-C was pressed."""
        return self._set

    def _handle(self, number: int, frame: FrameType | None) -> None:
        if self._set:
            raise KeyboardInterrupt
        self._set = True


@contextmanager
def terminable() -> Iterator[None]:
    """Let SIGTERM, with which batch systems and `kill` stop a process, act as Ctrl-C within the block.

    It does so even where InterruptFlag has changed the effect of Ctrl-C. In a thread other than the main one the block
    changes nothing.
    """
    if not _gets_signals():
        yield
        return
    before = signal.signal(signal.SIGTERM, _interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _interrupt(number: int, frame: FrameType | None) -> None:
    """Do what Ctrl-C does. A process that a script has put into the background ignores SIGINT itself."""
    on_interrupt = signal.getsignal(signal.SIGINT)
    if not callable(on_interrupt):
        raise KeyboardInterrupt
    on_interrupt(signal.SIGINT, frame)


@contextmanager
def ending_workers() -> Iterator[None]:
    """Terminate all child processes if the block ends by an error or an interruption, instead of waiting for them.

    They must have called `end_when_told`, so that they clean up.
    """
    try:
        yield
    except BaseException:
        for worker in multiprocessing.active_children():
            worker.terminate()
        raise


def end_when_told() -> None:
    """Make this worker process clean up and end at SIGTERM, and ignore Ctrl-C: its parent then sends SIGTERM."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda number, frame: sys.exit(128 + number))


def _gets_signals() -> bool:
    return threading.current_thread() is threading.main_thread()
