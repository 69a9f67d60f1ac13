"""Handling of Ctrl-C and SIGTERM: a step that must end first, a process that must clean up, the workers of a pool."""

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing.process import BaseProcess
from types import FrameType, TracebackType
from typing import Any, TypeVar

Result = TypeVar("Result")


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

    It does so even where InterruptFlag has changed the effect of Ctrl-C. The block then ends by KeyboardInterrupt, also
    where a library has made another error of it, as OmegaConf does. In a thread other than the main one the block
    changes nothing.
    """
    if not _gets_signals():
        yield
        return
    told = False

    def interrupt(number: int, frame: FrameType | None) -> None:
        nonlocal told
        told = True
        raise KeyboardInterrupt

    def terminate(number: int, frame: FrameType | None) -> None:
        now = signal.getsignal(signal.SIGINT)  # ignored in a process that a script has put into the background
        (now if callable(now) else interrupt)(signal.SIGINT, frame)

    before = {signal.SIGTERM: signal.signal(signal.SIGTERM, terminate)}
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        before[signal.SIGINT] = signal.signal(signal.SIGINT, interrupt)
    try:
        yield
    except Exception as error:
        if told:
            raise KeyboardInterrupt from error
        raise
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def stopping_workers() -> Iterator[None]:
    """Stop the units of all child processes if the block ends by an error or an interruption.

    The processes must have called `stop_when_told`.
    """
    try:
        yield
    except BaseException:
        for worker in multiprocessing.active_children():
            worker.terminate()
        raise


class _Worker:
    """What a worker process knows of itself."""

    told = False  # to stop
    working = False


class StoppedError(Exception):
    """A unit of work was stopped, or not begun, as its process was told to stop."""


def stop_when_told() -> None:
    """Let SIGTERM stop the unit that this worker process works on, and ignore Ctrl-C: its parent then sends SIGTERM.

    The process itself does not end, and no signal interrupts it outside of a unit: there it may hold a lock that
    workers share, and a worker that dies with it, or lets half a result into their pipe, makes all others wait forever.
    The pool ends the process; if the parent is killed, the process ends at once.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, _stop)
    if (parent := multiprocessing.parent_process()) is not None:
        threading.Thread(target=_end_after, args=(parent,), daemon=True).start()


def _end_after(parent: BaseProcess) -> None:
    """End this process when its parent has: one that was killed tells nobody, and its workers would wait forever."""
    parent.join()
    os._exit(1)


def _stop(number: int, frame: FrameType | None) -> None:
    _Worker.told = True
    if _Worker.working:
        raise SystemExit(128 + number)


def stoppable(work: Callable[[], Result]) -> Result:
    """Do a unit of work in a worker process, so that it can be stopped and cleans up; raises StoppedError then."""
    try:
        if _Worker.told:
            raise SystemExit
        _Worker.working = True
        try:
            return work()
        finally:
            _Worker.working = False
    except SystemExit as error:
        _Worker.working = False  # the signal may have come just before the line above
        raise StoppedError from error


def _gets_signals() -> bool:
    return threading.current_thread() is threading.main_thread()
