"""The subcommand `nte import`."""

import argparse
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from nte.cli.parsing import Commands, add_force, command
from nte.errors import NteError, printable

if TYPE_CHECKING:
    from nte.importing.exr import Imported


def add(commands: Commands) -> None:
    """Add `import exr|blender|noisebase` to the subcommands of `nte`."""
    text = "make a clip of another producer's files, and check it (exit 2: implausible; the clip is kept)"
    parser = commands.add_parser("import", help=text, description=text)
    kinds = parser.add_subparsers(dest="kind", metavar="KIND", required=True)

    exr = _kind(kinds, "exr", _exr, "any EXR sequence, described by a channel map")
    text = "which layers are what: a YAML file, or the name of a map that ships, such as vray"
    exr.add_argument("--map", required=True, metavar="MAP", help=text)
    blender = _kind(kinds, "blender", _blender, "multi-layer EXR of Blender's Cycles")
    for each in (exr, blender):
        each.add_argument("--reference", type=Path, metavar="SOURCE", help="the same frames without noise")
        each.add_argument(
            "overrides", nargs="*", default=[], metavar="key=value", help="changes to the map, such as view=left"
        )
    noisebase = _kind(kinds, "noisebase", _noisebase, "noisebase: a sequence's zip, or a folder with a zip per frame")
    noisebase.add_argument("--spp", type=int, default=1, help="stored samples that color is the mean of (default: 1)")


def _kind(
    kinds: Commands, name: str, read: Callable[[argparse.Namespace], "Imported"], text: str
) -> argparse.ArgumentParser:
    parser = command(kinds, name, partial(_import, read), text, "import")
    parser.add_argument("source", type=Path, metavar="SOURCE", help="a folder, a file, or a quoted pattern")
    parser.add_argument("--out", type=Path, required=True, metavar="CLIP", help="folder for the clip")
    add_force(parser, "replace a clip that exists")
    return parser


def _import(read: Callable[[argparse.Namespace], "Imported"], options: argparse.Namespace) -> int:
    from nte.importing.outcome import tell  # first: where PyTorch is missing, which the check needs, nothing is written

    if surplus := next((item for item in getattr(options, "overrides", []) if "=" not in item), None):
        raise NteError(f"'{surplus}': expected key=value after one SOURCE: quote a pattern, 'frames/shot.*.exr'")
    imported = read(options)
    for note in imported.notes:
        print(f"  {printable(note)}")
    return tell(imported)


def _exr(options: argparse.Namespace) -> "Imported":
    from nte.importing.exr import import_exr

    return import_exr(options.source, options.map, options.out, options.reference, options.force, options.overrides)


def _blender(options: argparse.Namespace) -> "Imported":
    from nte.importing.blender import import_blender

    return import_blender(options.source, options.out, options.reference, options.force, options.overrides)


def _noisebase(options: argparse.Namespace) -> "Imported":
    from nte.importing.noisebase import import_noisebase

    return import_noisebase(options.source, options.out, options.spp, options.force)
