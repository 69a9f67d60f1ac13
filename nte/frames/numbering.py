"""The order of a sequence's files: by the frame numbers in their names, without gaps."""

import re
from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

from nte.errors import NteError

# A minus is a sign at the start of a name and after a separator, but not in «shot-0005», «take2-0005», «(2)-0005».
FRAME_NUMBER = r"(?:(?<![^\W_])(?<![)\]}])-)?\d+"
_NUMBER = re.compile(FRAME_NUMBER)
_VERSION = re.compile(r"(?<![A-Za-z])[vV]$")  # text before the digits of v002


class _Name(NamedTuple):
    """A file's name, cut at its numbers: len(texts) = len(numbers) + 1."""

    path: Path
    texts: tuple[str, ...]
    numbers: tuple[int, ...]

    @property
    def shape(self) -> str:
        return "#".join(self.texts)


def by_number(paths: Iterable[Path]) -> dict[int, Path]:
    """Sort files by their frame numbers: frame number → file, in order.

    The frame number is the one that differs from name to name. A version (v002) is ignored if the name has another
    number; a minus after a separator is a sign. A single file needs no number; if it has several, the last one
    counts. Raises NteError for a frame that is missing or there twice, for a name without a number among several
    files, for two sequences side by side or in two folders, if two numbers of the names change differently, and if
    every number follows two hyphens.
    """
    names = [_parse(path) for path in paths]
    if len(names) == 1:
        return {(names[0].numbers or (0,))[-1]: names[0].path}
    for name in names:
        if not name.numbers:
            raise NteError(f"{name.path}: has no frame number in its name: choose the frames by a pattern")
    _refuse_folders(names)
    _refuse_two_sequences(names)
    place = _varying(names)
    if all(name.numbers[place] < 0 and name.texts[place].endswith("-") for name in names):
        both = f"as that of {names[0].path.name}, may be a minus or part of a separator"
        raise NteError(f"{names[0].path.parent}: a hyphen after a hyphen, {both}: rename the files")
    return in_sequence((name.numbers[place], name.path) for name in names)


def in_sequence(numbered: Iterable[tuple[int, Path]]) -> dict[int, Path]:
    """Sort numbered files: frame number → file, in order.

    Raises NteError for a number that is missing or there twice.
    """
    found: dict[int, Path] = {}
    for number, path in numbered:
        if number in found:
            both = f"{found[number].name} and {path.name}"
            raise NteError(f"{path.parent}: frame {number} is there twice ({both}): choose one sequence by a pattern")
        found[number] = path
    for before, after in pairwise(sorted(found)):
        if after != before + 1:
            both = f"after {found[before].name} comes {found[after].name}"
            raise NteError(
                f"{found[after].parent}: frame {before + 1} is missing: {both}: render or copy it, or choose those "
                "before or after it"
            )
    return dict(sorted(found.items()))


def _parse(path: Path) -> _Name:
    matches = list(_NUMBER.finditer(path.stem))
    frames = [m for m in matches if not _VERSION.search(path.stem[: m.start()])]
    matches = frames or matches
    cuts = [0, *(cut for m in matches for cut in m.span()), len(path.stem)]
    texts = tuple(path.stem[a:b] for a, b in zip(cuts[::2], cuts[1::2], strict=True))
    return _Name(path, texts, tuple(int(m.group()) for m in matches))


def _refuse_folders(names: Sequence[_Name]) -> None:
    """Raise NteError for files of several folders, unless each has its own: in turn, they would pass as one."""
    given = {name.path.parent for name in names}
    folders = sorted({folder.resolve(): folder for folder in given}.values())  # a/../b is b
    if 1 < len(folders) < len(names):
        what = f"{folders[0]} and {folders[1]}: the frames lie in {len(folders)} folders"
        raise NteError(f"{what}: choose those of one, or link all into one if they are one sequence")


def _refuse_two_sequences(names: Sequence[_Name]) -> None:
    shapes: dict[str, list[Path]] = {}
    for name in names:
        shapes.setdefault(name.shape, []).append(name.path)
    if len(shapes) > 1:
        listed = " and ".join(_example(shapes, shape) for shape in sorted(shapes)[:2])
        more = f" and {len(shapes) - 2} more" if len(shapes) > 2 else ""
        raise NteError(
            f"{names[0].path.parent}: holds {len(shapes)} sequences, {listed}{more}: choose one by a pattern, "
            "or say in a channel map (--map) which file has which channel"
        )


def _example(shapes: Mapping[str, Sequence[Path]], shape: str) -> str:
    paths = shapes[shape]
    return f"{paths[0].name} ({len(paths)} file{'s' if len(paths) > 1 else ''})"


def _varying(names: Sequence[_Name]) -> int:
    """Find which of the numbers in the names differs from name to name; the last one if several do alike, or none."""
    columns = list(zip(*(name.numbers for name in names), strict=True))
    differing = [i for i, column in enumerate(columns) if len(set(column)) > 1]
    if len({columns[i] for i in differing}) > 1:
        first = names[0].path
        both = f"such as {first.name} and {next(n.path.name for n in names if n.path != first)}"
        raise NteError(
            f"{first.parent}: {len(differing)} numbers differ in the names, {both}: choose by a pattern, or say in a "
            "channel map (--map) which is the frame, as # of a file"
        )
    return differing[-1] if differing else len(columns) - 1
