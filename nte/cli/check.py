"""The subcommand `nte check`."""

import argparse
from pathlib import Path

from nte.cli.parsing import Commands, add_force, command


def add(commands: Commands) -> None:
    """Add `check` to the subcommands of `nte`."""
    text = "are the vectors and values of clips plausible? (exit 2: not)"
    parser = command(commands, "check", _check, text, "eval")
    parser.add_argument("clips", type=Path, nargs="+", metavar="CLIP", help="clips, or folders of clips")
    parser.add_argument("--picture", type=Path, metavar="FOLDER", help="draw motion, masks and residuals, a PNG a clip")
    add_force(parser)


def _check(options: argparse.Namespace) -> int:
    from nte.checking import check, describe, draw
    from nte.files import make_folder, refuse_to_replace
    from nte.frames.clip import Clip, find_clips
    from nte.frames.show import write_png

    implausible = 0
    for folder in find_clips(options.clips):
        clip = Clip(folder)
        report = check(clip)
        implausible += report.verdict == "implausible"
        print(describe(report))
        if options.picture and len(clip) > 1:
            path = options.picture / f"{'_'.join(folder.parts[-2:])}.png"
            refuse_to_replace((path,), options.force)
            make_folder(path.parent)
            write_png(path, draw(clip, report.telling_frame))
            print(f"  picture of frame {report.telling_frame}: {path}")
    return 2 if implausible else 0
