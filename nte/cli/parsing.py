"""What the parsers of the subcommands have in common."""

import argparse
from collections.abc import Callable
from typing import NoReturn, Protocol

DENOISER = "run, .onnx, or name:key=value"  # how a denoiser is typed


class Parser(argparse.ArgumentParser):
    """A parser that tells what is wrong in one line, as for any other wrong input; the usage is a --help away."""

    def error(self, message: str) -> NoReturn:
        """End the process with status 2."""
        self.exit(2, f"{self.prog}: error: {message}; see {self.prog} --help\n")


class Commands(Protocol):
    """The subcommands of a parser: what ArgumentParser.add_subparsers returns."""

    def add_parser(self, name: str, *, help: str, description: str) -> argparse.ArgumentParser: ...


def command(
    commands: Commands, name: str, run: Callable[[argparse.Namespace], int | None], text: str, extra: str = ""
) -> argparse.ArgumentParser:
    """Add a subcommand and return its parser; `run` does it and gives the exit status, None for 0.

    extra: the optional dependencies that bring what it imports, for the error where that is missing.
    """
    parser = commands.add_parser(name, help=text, description=text)
    parser.set_defaults(run=run, extra=extra)
    return parser


def add_force(parser: argparse.ArgumentParser, text: str = "overwrite what exists") -> None:
    """Add --force."""
    parser.add_argument("--force", action="store_true", help=text)


def add_device(parser: argparse.ArgumentParser, default: str = "cpu") -> None:
    """Add --device."""
    parser.add_argument("--device", default=default, help=f"cpu, cuda, … (default: {default})")
