"""Finding the files of a sequence, in the order of their numbers."""

import glob
from pathlib import Path

from nte.errors import NteError
from nte.frames.numbering import by_number


def numbered_files(source: Path, suffix: str) -> dict[int, Path]:
    """Frame number → file, in order, for a folder, a glob pattern or one file; suffix is ".exr" or ".zip".

    Raises NteError where nothing is found, and where the numbering has a gap.
    """
    if source.is_dir():
        paths = sorted(path for path in source.iterdir() if path.suffix.lower() == suffix and path.name[0] != ".")
    else:
        paths = sorted(map(Path, glob.glob(str(source))))
    if not paths:
        what = f"no {suffix} file in it" if source.is_dir() else "does not exist"
        raise NteError(f"{source}: {what}: expected a folder, a file or a quoted pattern of {suffix} frames")
    return by_number(paths)
