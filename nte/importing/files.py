"""Finding the files of a sequence, in the order of their numbers."""

import glob
import re
from itertools import pairwise
from pathlib import Path

from nte.errors import NteError


def numbered_files(source: Path, suffix: str) -> dict[int, Path]:
    """Frame number → file, in order, for a folder, a glob pattern or one file; suffix is ".exr" or ".zip".

    The number is the last one in a file's name. Raises NteError where nothing is found, where a number is
    missing or used twice, and for a name without a number among several files.
    """
    if source.is_dir():
        paths = sorted(path for path in source.iterdir() if path.suffix.lower() == suffix and path.name[0] != ".")
    else:
        paths = sorted(map(Path, glob.glob(str(source))))
    if not paths:
        what = f"no {suffix} file in it" if source.is_dir() else "does not exist"
        raise NteError(f"{source}: {what}: expected a folder, a file or a quoted pattern of {suffix} frames")
    if len(paths) == 1:
        return {_number(paths[0]) or 0: paths[0]}
    found: dict[int, Path] = {}
    for path in paths:
        number = _number(path)
        if number is None:
            raise NteError(f"{path}: has no frame number in its name: choose the frames by a pattern")
        if number in found:
            names = f"{found[number].name} and {path.name}"
            raise NteError(f"{source}: frame {number} is there twice ({names}): choose one sequence by a pattern")
        found[number] = path
    numbers = sorted(found)
    for before, after in pairwise(numbers):
        if after != before + 1:
            names = f"after {found[before].name} comes {found[after].name}"
            raise NteError(f"{source}: frame {before + 1} is missing: {names}")
    return {number: found[number] for number in numbers}


def _number(path: Path) -> int | None:
    digits = re.findall(r"\d+", path.stem)
    return int(digits[-1]) if digits else None
