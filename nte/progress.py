"""Progress of long work: a bar on a terminal, plain lines when piped."""

import sys
import time
from types import TracebackType
from typing import Self

from tqdm import tqdm

from nte.errors import printable

INTERVAL = 10  # seconds without a line after which one says how far the work is


class Progress:
    """Display of progress up to `total` on stderr: a tqdm bar on a terminal, else lines.

    There is a line for each `say`, and one every INTERVAL seconds in which there was none.

    unit: the name of one piece of work. shown: false for silence. done: pieces that an earlier command has finished.
    """

    def __init__(self, title: str, total: int, unit: str, shown: bool = True, done: int = 0) -> None:
        self.total, self.done, self.unit = total, done, unit
        self.lines, self._title, self._told = shown and not sys.stderr.isatty(), title, time.monotonic()
        silent = not shown or self.lines
        self.bar = tqdm(total=total, initial=done, desc=title, unit=unit, disable=silent, dynamic_ncols=True)

    def advance(self, count: int) -> None:
        """Add `count` pieces of finished work."""
        self.done += count
        self.bar.update(count)
        if self.lines and count and time.monotonic() - self._told > INTERVAL:
            self._print(self._title)

    def reach(self, done: int, total: int, what: str) -> None:
        """Set finished work and total, for work that learns its total on the way; say `what` when all is done."""
        self.total = self.bar.total = total
        self.advance(done - self.done)
        if done == total:
            self.say(what)

    def say(self, what: str) -> None:
        """Show the name of the piece of work that has just been finished."""
        what = printable(what)
        self.bar.set_postfix_str(what)
        if self.lines:
            self._print(what)

    def told(self) -> None:
        """Count a line that the work itself has printed as one of these."""
        self._told = time.monotonic()

    def _print(self, what: str) -> None:
        print(f"{what} ({self.done}/{self.total} {self.unit}s)", file=sys.stderr, flush=True)
        self.told()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.bar.close()
