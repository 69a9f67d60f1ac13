"""Silence for C libraries that print complaints about damaged files."""

import ctypes
import os
import sys
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, redirect_stderr, redirect_stdout
from functools import cache
from io import StringIO
from typing import Any, TextIO, cast

_lock = threading.Lock()  # of the two below
_silenced: list[int] = []  # the threads within `quiet`
_streams = ExitStack()  # what the first of them has changed, until the last one leaves


class _OtherThreads:
    """A stream that drops what silenced threads print, and hands on what others do."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        return len(text) if threading.get_ident() in _silenced else self._stream.write(text)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


@contextmanager
def quiet() -> Iterator[None]:
    """Silence messages that a C library prints about a damaged file: the NteError that follows says enough.

    Drops what this thread prints through Python, which the OpenEXR library does as well, and what any thread prints
    through C's stderr, as long as the block runs. What other threads print through Python is shown, such as the steps
    of a training whose clips this thread reads. Several threads may be in the block at once.
    """
    thread = threading.get_ident()
    with _lock:
        if not _silenced:
            out, err = (cast(TextIO, _OtherThreads(stream or StringIO())) for stream in (sys.stdout, sys.stderr))
            for change in (_without_c_stderr(), redirect_stdout(out), redirect_stderr(err)):
                _streams.enter_context(change)
        _silenced.append(thread)
    try:
        yield
    finally:
        with _lock:
            _silenced.remove(thread)
            if not _silenced:
                _streams.close()


@contextmanager
def _without_c_stderr() -> Iterator[None]:
    stderr, nowhere = _c_stderr()
    before, stderr.value = stderr.value, nowhere
    try:
        yield
    finally:
        stderr.value = before


@cache
def _c_stderr() -> tuple[ctypes.c_void_p, int | None]:
    """The variable from which C code takes its stderr, and a stream for it that leads nowhere.

    Where C has no such variable, or a constant one (Windows, musl), it is one of our own: messages are seen there.
    """
    name = {"darwin": "__stderrp", "linux": "stderr"}.get(sys.platform)
    if name and (sys.platform == "darwin" or os.confstr("CS_GNU_LIBC_VERSION")):
        libc = ctypes.CDLL(None)
        libc.fopen.restype = ctypes.c_void_p
        if nowhere := libc.fopen(os.devnull.encode(), b"w"):
            return ctypes.c_void_p.in_dll(libc, name), nowhere
    return ctypes.c_void_p(), None
