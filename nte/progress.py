"""Progress of long work: a bar on a terminal, plain lines when piped."""

import sys
from types import TracebackType
from typing import Self

from tqdm import tqdm


class Progress:
    """Counts work up to `total` on stderr. On a terminal a tqdm bar; else a line per `say`; or silence."""

    def __init__(self, title: str, total: int, unit: str, shown: bool = True) -> None:
        self.total, self.done, self.unit = total, 0, unit
        self.lines = shown and not sys.stderr.isatty()
        self.bar = tqdm(total=total, desc=title, unit=unit, disable=not shown or self.lines, dynamic_ncols=True)

    def advance(self, count: int) -> None:
        """So much more is done."""
        self.done += count
        self.bar.update(count)

    def reach(self, done: int, total: int, what: str) -> None:
        """So much of so much is done: for work that learns its total on the way."""
        self.total = self.bar.total = total
        self.advance(done - self.done)
        if done == total:
            self.say(what)

    def say(self, what: str) -> None:
        """Name what has just been finished."""
        self.bar.set_postfix_str(what)
        if self.lines:
            print(f"{what} ({self.done}/{self.total} {self.unit}s)", file=sys.stderr, flush=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.bar.close()
