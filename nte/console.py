"""Stdout and stderr of a command, which may be full or closed; no name that is printed steers a terminal."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any, TextIO, cast

from nte.errors import NteError, printable


class NoReaderError(Exception):
    """Nobody reads stdout any more: nte info … | head.

    It is no OSError, which argparse drops, and pipes of processes raise as well.
    """


class _Stream:
    """A text stream that hands on everything to another one."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


class _Stdout(_Stream):
    """Results: control characters are shown escaped, and what cannot be written is an NteError."""

    def write(self, text: str) -> int:
        with _told():
            self._stream.write(printable(text, but="\n\t"))
        return len(text)

    def flush(self) -> None:
        with _told():
            self._stream.flush()


class _Stderr(_Stream):
    """Progress and messages: work does not end because nobody can read them."""

    def write(self, text: str) -> int:
        with suppress(OSError):
            self._stream.write(text)
        return len(text)

    def flush(self) -> None:
        with suppress(OSError):
            self._stream.flush()


@contextmanager
def _told() -> Iterator[None]:
    try:
        yield
    except BrokenPipeError as error:
        raise NoReaderError from error
    except OSError as error:
        raise NteError(f"stdout: cannot be written: {error.strerror or error}") from error


@contextmanager
def standard_streams() -> Iterator[None]:
    """Let a command use stdout and stderr within the block, also if they are closed (as os.devnull) or full.

    Within it, writing to stdout raises NteError where it fails, and NoReaderError where the reader has gone. What a
    stream has not taken by the end is dropped, since Python would try once more, and exit with a status of its own.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:  # somebody's file would get the number, and what C code prints
            os.open(os.devnull, os.O_RDWR)
    before = sys.stdout, sys.stderr
    opened = [stream or open(os.devnull, "w", encoding="utf-8") for stream in before]  # noqa: SIM115
    sys.stdout, sys.stderr = cast(TextIO, _Stdout(opened[0])), cast(TextIO, _Stderr(opened[1]))
    try:
        yield
    finally:
        sys.stdout, sys.stderr = before
        for stream in opened:
            try:
                stream.flush()
            except OSError:
                os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
