"""Common parts of the subcommands' parsers."""

import argparse
import re
from collections.abc import Callable
from typing import NoReturn, Protocol

from nte.errors import printable
from nte.runtime.providers import PROVIDERS

# help text of a denoiser's specification
DENOISER = (
    "run, released model, model.onnx, model.onnx:provider=NAME, name:key=value, package.module:Class, or "
    "composite:visibility=SPEC,glossy=[SPEC,with=commas],indirect=SPEC"
)


class Parser(argparse.ArgumentParser):
    """A parser whose errors are one line, as for any other wrong input, without the usage."""

    def error(self, message: str) -> NoReturn:
        """Print the message in one line and end the process with status 2."""
        self.exit(2, f"{self.prog}: error: {printable(message)}; see {self.prog} --help\n")


class Commands(Protocol):
    """The subcommands of a parser, as ArgumentParser.add_subparsers returns them."""

    def add_parser(self, name: str, *, help: str, description: str) -> argparse.ArgumentParser: ...


def command(
    commands: Commands, name: str, run: Callable[[argparse.Namespace], int | None], text: str, extra: str = ""
) -> argparse.ArgumentParser:
    """Add a subcommand and return its parser.

    run: called with the parsed options; returns the exit status, None for 0. extra: the optional dependencies that
    install its imports, named in the error if one is missing.
    """
    parser = commands.add_parser(name, help=text, description=text)
    parser.set_defaults(run=run, extra=extra)
    return parser


def add_force(parser: argparse.ArgumentParser, text: str = "overwrite what exists") -> None:
    """Add the option --force; `text` says in the help what it does."""
    parser.add_argument("--force", action="store_true", help=text)


def add_device(parser: argparse.ArgumentParser, default: str = "cpu") -> None:
    """Add the option --device."""
    parser.add_argument("--device", default=default, help=f"cpu, cuda, … (default: {default})")


def add_provider(parser: argparse.ArgumentParser) -> None:
    """Add the option --provider."""
    text = "where exported models run, short for model.onnx:provider=NAME (default: by --device)"
    parser.add_argument("--provider", choices=PROVIDERS, help=text)


def add_jobs(parser: argparse.ArgumentParser, unit: str) -> None:
    """Add the options --jobs and --scheduler, of which one may be given. unit: what a process does at a time."""
    where = parser.add_mutually_exclusive_group()
    where.add_argument(
        "--jobs", type=_count, default=1, metavar="N", help=f"processes that share the cores, each on {unit}"
    )
    where.add_argument(
        "--scheduler", metavar="tcp://HOST:PORT", help=f"work on a Dask cluster that sees the folders: {unit} a worker"
    )


def parse_size(text: str) -> tuple[int, int]:
    """Parse WIDTHxHEIGHT to (height, width); raises argparse's error for anything else."""
    match = re.fullmatch(r"([1-9]\d*)x([1-9]\d*)", text)
    if not match:
        raise argparse.ArgumentTypeError(f"'{text}' is no size: expected WIDTHxHEIGHT, such as 1280x720")
    return int(match[2]), int(match[1])


def _count(text: str) -> int:
    """Parse a number of processes; raises argparse's error below 1."""
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r:.40}: expected a number of processes, 1 or more")
    return int(text)


def parse_frames(text: str) -> range:
    """Parse FIRST-LAST, or one number; raises argparse's error for anything else."""
    match = re.fullmatch(r"(-?\d{1,9})(?:-(-?\d{1,9}))?", text)
    first, last = (int(match[1]), int(match[2] or match[1])) if match else (1, 0)
    if last < first:
        raise argparse.ArgumentTypeError(f"{text!r:.40}: expected the first and the last frame, such as 10-20")
    return range(first, last + 1)
