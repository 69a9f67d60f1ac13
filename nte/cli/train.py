"""The subcommand `nte train`."""

import argparse
import os
from pathlib import Path

from nte.cli.parsing import Commands, add_device, add_force, command


def add(commands: Commands) -> None:
    """Add `train` to the subcommands of `nte`."""
    parser = command(commands, "train", _train, "train a network; writes runs/<name>/", "train")
    parser.add_argument("config", type=Path, metavar="CONFIG.yaml", help="clips, network, losses, optimiser, phases")
    parser.add_argument("overrides", nargs="*", default=[], metavar="key=value", help="for example resume=true")
    text = "measure some steps instead: time by stage, share of the machine's speed; writes nothing"
    parser.add_argument("--profile", action="store_true", help=text)
    add_device(parser, "auto")
    add_force(parser)


def _train(options: argparse.Namespace) -> None:
    if options.profile:
        from nte.training.config import load_train_config
        from nte.training.profile import profile_training

        print(profile_training(load_train_config(options.config, options.overrides), options.device).table())
        return
    from nte.training.loop import train

    folder = train(options.config, options.force, options.device, options.overrides)
    if os.environ.get("RANK", "0") == "0":  # torchrun starts several processes
        print(folder)
