"""The command line of every benchmark: help from its docstring; bad input is one line and exit status 2."""

import argparse
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NoReturn

from nte.cli.parsing import Parser
from nte.errors import NteError


def make_parser(text: str | None) -> Parser:
    """Make the parser of the benchmark that runs. text: its docstring, which is its help."""
    return Parser(prog=_name(), description=text, formatter_class=argparse.RawDescriptionHelpFormatter)


def count(text: str) -> int:
    """Parse a number of things; raises argparse's error below 1."""
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r:.40}: expected a whole number, 1 or more")
    return int(text)


def run(main: Callable[[Sequence[str]], int | None]) -> NoReturn:
    """Run a benchmark on the arguments of this process, and end the process with the status that it returns.

    An error that is meant for users, and a file that cannot be opened, are one line and status 2.
    """
    try:
        sys.exit(main(sys.argv[1:]))
    except NteError as error:
        what = str(error)
    except OSError as error:
        what = f"{error.filename}: {error.strerror}" if error.filename else str(error)
    print(f"{_name()}: {what}", file=sys.stderr)
    sys.exit(2)


def _name() -> str:
    return f"benchmarks.{Path(sys.argv[0]).stem}"
