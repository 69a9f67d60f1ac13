"""Search for the files of a sequence, in the order of their numbers."""

import glob
import re
from pathlib import Path

from nte.errors import NteError
from nte.files import is_file_or_lost
from nte.frames.numbering import FRAME_NUMBER, by_number, in_sequence


def numbered_files(source: Path, suffix: str) -> dict[int, Path]:
    """Find the files of a folder, a glob pattern or one file: frame number → file, in order.

    suffix: ".exr" or ".zip", for a folder. Raises NteError if nothing is found, if the numbering has a gap, and if the
    files are more than one sequence.
    """
    if source.is_dir():
        shown = (path for path in source.iterdir() if path.name[0] != "." and is_file_or_lost(path))
        paths = sorted(path for path in shown if path.suffix.lower() == suffix)
    elif source.exists():  # its name may contain characters that are special in a pattern
        paths = [source]
    else:
        folder = glob.escape(str(source.parent)) if source.parent.is_dir() else str(source.parent)
        # Brackets are part of most names that have some: «shot [v2].*.exr» is no set of characters.
        patterns = (source.name, source.name.replace("[", "[[]"))
        matches = next(filter(None, (glob.glob(f"{folder}/{pattern}") for pattern in patterns)), [])
        paths = sorted(path for path in map(Path, matches) if is_file_or_lost(path))
    if not paths:
        what = f"no {suffix} file in it" if source.is_dir() else "does not exist"
        raise NteError(f"{source}: {what}: expected a folder, a file or a quoted pattern of {suffix} frames")
    return by_number(paths)


def files_of_pattern(folder: Path, pattern: str) -> dict[int, Path]:
    """Find the files below `folder` whose names fit a pattern: frame number → file, in order; empty if none fits.

    In a pattern # (or ####) is the frame number with any number of digits, * is any part of a name, the same in all
    files or another in each, and everything else stands for itself. Hidden files and folders are left out. Raises
    NteError for a gap in the numbers, for more than one sequence that fits, and for a pattern with two frame numbers.
    """
    parts = re.split(r"(#+|\*)", Path(pattern).as_posix())
    kinds = {"#": f"({FRAME_NUMBER})", "*": "([^/]*?)"}  # as short as possible: a number belongs to # as a whole
    expression = re.compile("".join(kinds.get(part[:1], re.escape(part)) for part in parts if part))
    marks = [part[0] for part in parts if part[:1] in ("#", "*")]
    if marks.count("#") > 1:
        raise NteError(f"{folder}: the pattern '{pattern}' has # more than once: expected one frame number")
    files = [(path.relative_to(folder).as_posix(), path) for path in sorted(folder.rglob("*")) if is_file_or_lost(path)]
    names = [(name, path) for name, path in files if not re.search(r"(^|/)\.", name)]
    fitting = [(match, path) for name, path in names if (match := expression.fullmatch(name))]
    if "#" not in marks:
        return by_number(path for _, path in fitting) if fitting else {}
    for star in (place for place, mark in enumerate(marks, 1) if mark == "*"):
        starts = {match[star]: path.name for match, path in fitting}
        if 1 < len(starts) < len(fitting):  # numbered in turn, they would pass as one
            both = " and ".join([*starts.values()][:2])
            raise NteError(f"{folder}: '{pattern}' fits {len(starts)} sequences, such as {both}: name one of them")
    return in_sequence((int(match[marks.index("#") + 1]), path) for match, path in fitting)
