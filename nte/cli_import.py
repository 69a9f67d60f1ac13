"""`nte import`: its parsers, and what they run."""

import argparse
from pathlib import Path
from typing import Any


def add_import(commands: Any) -> None:
    """Add `import exr|blender|noisebase` to the subcommands of `nte`."""
    text = "make a clip of another producer's files, and check it (exit 2: implausible; the clip is kept)"
    parser = commands.add_parser("import", help=text, description=text)
    kinds = parser.add_subparsers(dest="kind", metavar="KIND", required=True)

    exr = _kind(kinds, "exr", _exr, "any EXR sequence, described by a channel map (datasets/IMPORT.md)")
    exr.add_argument("--map", type=Path, required=True, metavar="MAP.yaml", help="which layers are what")
    blender = _kind(kinds, "blender", _blender, "multi-layer EXR of Blender's Cycles")
    for each in (exr, blender):
        each.add_argument("--reference", type=Path, metavar="SOURCE", help="the same frames without noise")
    noisebase = _kind(kinds, "noisebase", _noisebase, "noisebase: a sequence's zip, or a folder with a zip per frame")
    noisebase.add_argument("--spp", type=int, default=1, help="stored samples that color is the mean of (default: 1)")


def _kind(kinds: Any, name: str, run: Any, text: str) -> argparse.ArgumentParser:
    parser: argparse.ArgumentParser = kinds.add_parser(name, help=text, description=text)
    parser.add_argument("source", type=Path, metavar="SOURCE", help="a folder, a file, or a quoted pattern")
    parser.add_argument("--out", type=Path, required=True, metavar="CLIP", help="folder for the clip")
    parser.add_argument("--force", action="store_true", help="replace a clip that exists")
    parser.set_defaults(run=run)
    return parser


def _exr(options: argparse.Namespace) -> int:
    from nte.importing.check import tell
    from nte.importing.exr import import_exr

    return tell(import_exr(options.source, options.map, options.out, options.reference, options.force))


def _blender(options: argparse.Namespace) -> int:
    from nte.importing.blender import import_blender
    from nte.importing.check import tell

    return tell(import_blender(options.source, options.out, options.reference, options.force))


def _noisebase(options: argparse.Namespace) -> int:
    from nte.importing.check import tell
    from nte.importing.noisebase import import_noisebase

    return tell(import_noisebase(options.source, options.out, options.spp, options.force))
