"""The subcommand `nte denoise`."""

import argparse
from pathlib import Path

from nte.cli.parsing import DENOISER, Commands, add_device, add_force, add_provider, command
from nte.errors import NteError


def add(commands: Commands) -> None:
    """Add `denoise` to the subcommands of `nte`."""
    parser = command(commands, "denoise", _denoise, "denoise a clip or frames; writes linear OpenEXR")
    parser.add_argument("sources", type=Path, nargs="+", metavar="CLIP_OR_FOLDER_OR_FILES")
    parser.add_argument("--denoiser", required=True, metavar="SPEC", help=DENOISER)
    parser.add_argument("--out", type=Path, required=True, help="folder for the frames")
    text = "estimate, or estimate:key=value,…: motion from the images, instead of given vectors"
    parser.add_argument("--motion", metavar="estimate", help=text)
    text = "how to read another renderer's files: a channel map, or the name of one (default: the one that fits)"
    parser.add_argument("--map", metavar="MAP", help=text)
    text = "a change to the map, such as view=left; repeat it for more"
    parser.add_argument("--set", action="append", default=[], metavar="key=value", help=text)
    parser.add_argument("--exposure", type=float, help="linear factor of the sequence (default: estimated once)")
    parser.add_argument("--png", action="store_true", help="a tonemapped picture beside each frame")
    add_device(parser)
    add_provider(parser)
    add_force(parser)


def _denoise(options: argparse.Namespace) -> None:
    from nte.registry import load_denoiser, with_provider
    from nte.sequences import denoise_files

    if options.motion and options.motion.partition(":")[0] != "estimate":
        raise NteError(f"--motion {options.motion}: expected estimate, or estimate:key=value,…")
    spec = f"{options.motion}+{options.denoiser}" if options.motion else options.denoiser
    if options.provider:
        (spec,) = with_provider([spec], options.provider)
    denoiser = load_denoiser(spec, options.device)
    written = denoise_files(
        options.sources, denoiser, options.out, options.exposure, options.png, options.force, options.map, options.set,
        spec=spec,
    )  # fmt: skip
    print(f"{len(written)} frames in {options.out}")
