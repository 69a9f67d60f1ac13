"""The subcommand `nte info`."""

import argparse
from pathlib import Path

from nte.cli.parsing import Commands, command


def add(commands: Commands) -> None:
    """Add `info` to the subcommands of `nte`."""
    parser = command(commands, "info", _info, "describe a clip, a model, a run or a training configuration")
    text = "folder, .onnx or .yaml file, or the name of a released model"
    parser.add_argument("source", type=Path, metavar="CLIP|MODEL|RUN|CONFIG", help=text)


def _info(options: argparse.Namespace) -> None:
    from nte.info import describe

    print(describe(options.source))
