"""The subcommand `nte train`."""

import argparse
from pathlib import Path

from nte.cli.parsing import Commands, add_device, add_force, command


def add(commands: Commands) -> None:
    """Add `train` to the subcommands of `nte`."""
    parser = command(commands, "train", _train, "train a network; writes runs/<name>/", "train")
    parser.add_argument("config", type=Path, metavar="CONFIG.yaml", help="clips, network, losses, optimiser, phases")
    parser.add_argument("overrides", nargs="*", default=[], metavar="key=value", help="for example resume=true")
    add_device(parser, "auto")
    add_force(parser)


def _train(options: argparse.Namespace) -> None:
    from nte.training.loop import train

    print(train(options.config, options.force, options.device, options.overrides))
