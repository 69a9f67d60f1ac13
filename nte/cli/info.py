"""The subcommand `nte info`."""

import argparse
from pathlib import Path

from nte.cli.parsing import Commands, command


def add(commands: Commands) -> None:
    """Add `info` to the subcommands of `nte`."""
    parser = command(commands, "info", _info, "describe a clip, a model, a run or a training configuration")
    parser.add_argument("source", type=Path, metavar="CLIP|MODEL|RUN|CONFIG", help="folder, .onnx or .yaml file")


def _info(options: argparse.Namespace) -> None:
    from nte.info import describe

    print(describe(options.source))
