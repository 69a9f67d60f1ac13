"""The files that a channel map asks for: which channel comes from which file of each frame."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from nte.errors import NteError
from nte.frames.numbering import by_number
from nte.importing.channel_map import ChannelMap, needs_camera
from nte.importing.files import files_of_pattern, numbered_files
from nte.importing.source import Source


@dataclass(frozen=True)
class Input:
    """A channel that is read: its entry in the map, and the file of each frame."""

    name: str
    source: Source
    files: Sequence[Path]
    needed: bool  # false if the channel may be missing from every frame
    renumbered: bool = False  # a single file whose number, perhaps that of its samples, is not that of color's


def plan(source: Path | Sequence[Path], reference: Path | None, how: ChannelMap) -> tuple[list[int], list[Input]]:
    """List the frame numbers, and the channels to read, color first, with their files.

    Channels that lack a camera are left out; so are those whose pattern fits no file, if the map is optional. Raises
    NteError if the frame numbers of two channels differ, if a channel that is needed has no file, and for a list of
    files where the map names those of color.
    """
    folder = source if isinstance(source, Path) else source[0].parent
    wanted = {name: (folder, s) for name, s in how.channels.items() if not needs_camera(how, name)}
    if reference is not None:
        own, noisy = how.channels.get("reference"), how.channels["color"]
        wanted["reference"] = (reference, replace(own, layer=own.layer or noisy.layer) if own else noisy)
    needed = set(wanted) if not how.optional else {"color", *(["reference"] if reference is not None else [])}
    inputs: dict[str, tuple[Source, dict[int, Path]]] = {}
    known: dict[tuple[Path, str], dict[int, Path]] = {}
    if not isinstance(source, Path):
        if pattern := how.channels["color"].file:  # which would take the place of the files that are given
            what = f"the channel map names the files of color itself ('{pattern}'): expected their folder"
            raise NteError(f"{source[0]}: {what}; --frames chooses some of them")
        known[folder, ""] = by_number(source)
    for name in sorted(wanted, key=lambda name: name != "color"):
        where, s = wanted[name]
        if (where, s.file) not in known:
            known[where, s.file] = _files(where, s.file)
        files = known[where, s.file]
        if files:
            inputs[name] = s, files
        elif name in needed:
            raise NteError(f"{where}: no file fits '{s.file}', where 'channels.{name}.file' expects the frames")
    color, expected = inputs["color"]
    for name, (s, files) in inputs.items():
        stills = len(files) == len(expected) == 1 and not ("#" in s.file and "#" in color.file)  # whose numbers vary
        if list(files) != list(expected) and not stills:
            where = wanted[name][0] / s.file if s.file else wanted[name][0]
            first, second = (f"{min(f)} to {max(f)}" for f in (files, expected))
            raise NteError(
                f"{where}: '{name}' has {len(files)} frames ({first}), 'color' has {len(expected)} ({second}): "
                "expected the same frame numbers"
            )
    channels = [
        Input(name, s, list(files.values()), name in needed, list(files) != list(expected))
        for name, (s, files) in inputs.items()
    ]
    return list(expected), channels


def _files(where: Path, pattern: str) -> dict[int, Path]:
    if not pattern:
        return numbered_files(where, ".exr")
    if not where.is_dir():
        raise NteError(f"{where}: expected a folder, as the channel map names files in it ('{pattern}')")
    return files_of_pattern(where, pattern)
