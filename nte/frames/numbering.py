"""The order of a sequence's files: by the numbers in their names, without gaps."""

import re
from collections.abc import Iterable
from itertools import pairwise
from pathlib import Path

from nte.errors import NteError


def by_number(paths: Iterable[Path]) -> dict[int, Path]:
    """Frame number → file, in order; the number is the last one in a file's name.

    A single file needs no number. Raises NteError for a number that is missing or there twice, and for a
    name without one among several files.
    """
    listed = list(paths)
    if len(listed) == 1:
        return {_number(listed[0]) or 0: listed[0]}
    found: dict[int, Path] = {}
    for path in listed:
        number = _number(path)
        if number is None:
            raise NteError(f"{path}: has no frame number in its name: choose the frames by a pattern")
        if number in found:
            names = f"{found[number].name} and {path.name}"
            raise NteError(f"{path.parent}: frame {number} is there twice ({names}): choose one sequence by a pattern")
        found[number] = path
    for before, after in pairwise(sorted(found)):
        if after != before + 1:
            names = f"after {found[before].name} comes {found[after].name}"
            raise NteError(f"{found[after].parent}: frame {before + 1} is missing: {names}")
    return dict(sorted(found.items()))


def _number(path: Path) -> int | None:
    digits = re.findall(r"\d+", path.stem)
    return int(digits[-1]) if digits else None
