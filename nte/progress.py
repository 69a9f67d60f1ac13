"""Progress of long work: a bar on a terminal, plain lines when piped."""

import sys
from types import TracebackType
from typing import Self

from tqdm import tqdm

from nte.errors import printable


class Progress:
    """Display of progress up to `total` on stderr: a tqdm bar on a terminal, else one line for each `say`.

    unit: the name of one piece of work. shown: false for silence.
    """

    def __init__(self, title: str, total: int, unit: str, shown: bool = True) -> None:
        self.total, self.done, self.unit = total, 0, unit
        self.lines = shown and not sys.stderr.isatty()
        self.bar = tqdm(total=total, desc=title, unit=unit, disable=not shown or self.lines, dynamic_ncols=True)

    def advance(self, count: int) -> None:
        """Add `count` pieces of finished work."""
        self.done += count
        self.bar.update(count)

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
            print(f"{what} ({self.done}/{self.total} {self.unit}s)", file=sys.stderr, flush=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.bar.close()
