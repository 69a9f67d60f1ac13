"""The subcommand `nte merge-burst`."""

import argparse
from pathlib import Path

from nte.cli.parsing import Commands, add_force, command


def add(commands: Commands) -> None:
    """Add `merge-burst` to the subcommands of `nte`."""
    text = "merge a burst of photographs into one with less noise: raw files before demosaicing, or EXR, PNG or TIFF"
    parser = command(commands, "merge-burst", _merge, text, "burst")
    parser.add_argument("files", type=Path, nargs="+", metavar="FILES", help="raw photographs, or .exr, .png, .tif")
    parser.add_argument(
        "--out", type=Path, required=True, metavar="IMAGE", help=".exr (linear), or .png or .tif (as displayed)"
    )
    parser.add_argument("--bits", type=int, choices=(8, 16), default=16, help="of a .png or .tif (default: 16)")
    parser.add_argument(
        "--brightness",
        type=_stops,
        default=0.0,
        metavar="STOPS",
        help="make the picture brighter (below 0: darker), beside what a DNG asks for (default: 0)",
    )
    parser.add_argument("--keep-defects", action="store_true", help="do not fill in hot and dead pixels of the sensor")
    parser.add_argument(
        "--reference", type=int, default=1, metavar="NUMBER", help="the file to align to (default: 1, the first)"
    )
    parser.add_argument(
        "--noise",
        type=float,
        nargs=2,
        metavar=("A", "B"),
        help="variance A·x + B of a signal x, 1 the white level (default: fitted to the burst)",
    )
    parser.add_argument(
        "--radii",
        type=int,
        nargs="+",
        metavar="R",
        help="of the search's patches, finest level first (default: 16 8 4 2)",
    )
    add_force(parser)


def _stops(text: str) -> float:
    """Parse a brightness in stops; raises argparse's error outside −32 to 32, which is beyond any picture."""
    stops = float(text)
    if not -32 <= stops <= 32:
        raise argparse.ArgumentTypeError(f"{text}: expected stops from -32 to 32")
    return stops


def _merge(options: argparse.Namespace) -> None:
    from nte.burst.files import merge_files
    from nte.burst.merge import RADII
    from nte.burst.noise import NoiseModel
    from nte.progress import Progress
    from nte.writers import only_writer_of

    noise = NoiseModel(*options.noise) if options.noise else None
    radii = tuple(options.radii) if options.radii else RADII
    bar = Progress("merge", len(options.files) - 1, "photograph")
    with only_writer_of(options.out, options.force), bar as progress:
        done = merge_files(
            options.files, options.out, options.reference, noise, radii, options.force,
            lambda count: progress.reach(count, len(options.files) - 1, str(options.out)),
            options.brightness, options.bits, options.keep_defects,
        )  # fmt: skip
    print(f"noise: variance = {done.noise.a:.3g} · signal + {done.noise.b:.3g}")
    for path, frame in zip(done.others, done.merged.frames, strict=True):
        print(f"{path}: moved {frame.motion[0]:+.1f}, {frame.motion[1]:+.1f} px, {frame.share:.0%} used")
    if done.defects:
        print(f"{done.defects} pixels of the sensor are hot or dead: filled from other frames and from around them")
        if all(max(map(abs, frame.motion)) < 0.5 for frame in done.merged.frames):
            print("the camera stood still: a star of one pixel looks the same as a hot one; --keep-defects leaves both")
    print(f"{options.out}: the mean of {float(done.merged.weight.mean()):.1f} photographs")
