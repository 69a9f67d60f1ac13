"""The subcommand `nte view`."""

import argparse
from pathlib import Path

from nte.cli.parsing import DENOISER, Commands, add_device, add_force, command, parse_frames
from nte.errors import NteError, expected_one_of, printable


def add(commands: Commands) -> None:
    """Add `view` to the subcommands of `nte`."""
    text = "look at clips, and at what denoisers make of them, in a browser (exit 2: a denoiser failed)"
    parser = command(commands, "view", _view, text)
    parser.add_argument("clips", type=Path, nargs="+", metavar="CLIP", help="clips, or folders of clips")
    parser.add_argument("--denoiser", nargs="+", action="extend", default=[], metavar="SPEC", help=DENOISER)
    parser.add_argument("--out", type=Path, help="folder for the page (default: a temporary one)")
    parser.add_argument(
        "--frames", type=parse_frames, metavar="FIRST-LAST", help="the frames to show, such as 100-160 (default: all)"
    )
    text = "channels to show besides what is compared (default: all that the clip has)"
    parser.add_argument("--channels", nargs="+", metavar="NAME", help=text)
    parser.add_argument("--no-open", action="store_true", help="only write the page, do not open it")
    add_device(parser)
    add_force(parser, "replace a page that is there")


def _view(options: argparse.Namespace) -> int:
    import sys
    import tempfile
    import webbrowser

    from nte.evaluation.view import view
    from nte.frames.channels import CHANNELS
    from nte.progress import Progress
    from nte.registry import load_denoiser
    from nte.viewer.page import size_of

    for name in options.channels or ():
        if name not in CHANNELS:
            raise NteError(f"--channels {name}: no such channel{expected_one_of(name, CHANNELS)}")
    denoisers = {spec: load_denoiser(spec, options.device) for spec in dict.fromkeys(options.denoiser)}
    out = options.out or Path(tempfile.mkdtemp(prefix="nte_view_"))
    channels = None if options.channels is None else tuple(options.channels)
    failed: list[str] = []
    with Progress("view", 0, "frame") as progress:
        page = view(
            options.clips, denoisers, out, options.frames, channels, options.force, options.device, progress.reach,
            failed.append,
        )  # fmt: skip
    print(f"page: {page} ({size_of(out) / 1e6:.0f} MB in {out})")
    if not options.no_open and not webbrowser.open(page.resolve().as_uri()):
        print("no browser was found: open the page in one")
    for line in failed:
        print(f"nte: {printable(line)}", file=sys.stderr)
    return 2 if failed else 0
