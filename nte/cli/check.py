"""The subcommand `nte check`."""

import argparse
from collections.abc import Sequence
from pathlib import Path

from nte.cli.parsing import Commands, add_force, command
from nte.errors import NteError


def add(commands: Commands) -> None:
    """Add `check` to the subcommands of `nte`."""
    text = "are the vectors and values of clips plausible? (exit 2: not)"
    parser = command(commands, "check", _check, text, "eval")
    parser.add_argument("clips", type=Path, nargs="+", metavar="CLIP", help="clips, or folders of clips")
    parser.add_argument("--picture", type=Path, metavar="FOLDER", help="draw motion, masks and residuals, a PNG a clip")
    add_force(parser)


def _check(options: argparse.Namespace) -> int:
    from nte.checking import check, describe, draw, undrawable
    from nte.files import make_folder, refuse_to_replace
    from nte.frames.clip import Clip
    from nte.frames.clip_files import find_clips
    from nte.frames.show import write_png

    folders = find_clips(options.clips)
    clips = {name: Clip(folder) for name, folder in zip(picture_names(folders), folders, strict=True)}
    pictures = {}
    if options.picture:
        pictures = {name: options.picture / name for name, clip in clips.items() if not undrawable(clip)}
        refuse_to_replace(pictures.values(), options.force)
        make_folder(options.picture)
    implausible = 0
    for name, clip in clips.items():
        report = check(clip)
        implausible += report.verdict == "implausible"
        print(describe(report))
        if name in pictures:
            write_png(pictures[name], draw(clip, report.telling_frame))
            print(f"  picture of frame {report.telling_frame}: {pictures[name]}")
        elif options.picture:
            print(f"  no picture: {undrawable(clip)}")
    return 2 if implausible else 0


def picture_names(folders: Sequence[Path]) -> list[str]:
    """Name the picture of each clip by the last two names of its path, and by more where these name another clip too.

    Raises NteError where all names of two paths make the same file's name, such as a_b/c and a/b_c.
    """
    parts = [folder.resolve().parts[1:] for folder in folders]
    names = []
    for mine in parts:
        lengths = range(2, len(mine) + 1)
        alone = (n for n in lengths if [other[-n:] for other in parts].count(mine[-n:]) == 1)
        names.append(f"{'_'.join(mine[-next(alone, len(mine)) :])}.png")
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        both = " and ".join(str(folder) for folder, name in zip(folders, names, strict=True) if name == twice)
        raise NteError(f"{both}: the picture of each would be {twice}: check them one at a time")
    return names
