"""The subcommand `nte estimate`."""

import argparse
from pathlib import Path

from nte.cli.parsing import Commands, add_device, add_force, command


def add(commands: Commands) -> None:
    """Add `estimate` to the subcommands of `nte`."""
    text = "estimate the motion of a clip from its images; writes a clip with motion, its error and a mask"
    parser = command(commands, "estimate", _estimate, text, "eval")
    parser.add_argument("clip", type=Path, metavar="CLIP", help="folder with clip.json")
    parser.add_argument("--out", type=Path, required=True, help="folder for the clip with motion")
    parser.add_argument(
        "--noise", default="auto", help="of the images: clean, moderate, noisy or strong (default: auto, measured)"
    )
    parser.add_argument("--guides", action="store_true", help="search in albedo and normal instead of the image")
    parser.add_argument("--known", action="store_true", help="keep the clip's own motion where it is finite")
    add_device(parser)
    add_force(parser)


def _estimate(options: argparse.Namespace) -> None:
    from nte.estimation import estimate_clip
    from nte.filters.named import require_device

    require_device(options.device)
    written = estimate_clip(
        options.clip, options.out, options.noise, options.guides, options.known, options.device, options.force
    )
    print(f"{len(written)} frames in {options.out}")
