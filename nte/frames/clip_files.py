"""Where clips lie, and what their files are called."""

import os
import re
from collections.abc import Iterable, Sequence
from pathlib import Path

from nte.errors import NteError

_FILES = re.compile(r"(seed_\d{2}/)?(frame_\d{4,}\.exr|clip\.json)")


def frame_path(folder: Path, index: int, seed: int = 0) -> Path:
    """Return the path of a clip's frame: frame_0007.exr, or seed_01/frame_0007.exr for a further noise seed."""
    name = f"frame_{index:04d}.exr"
    return folder / f"seed_{seed:02d}" / name if seed else folder / name


def is_clip_file(name: str) -> bool:
    """Tell whether a name, relative to a clip's folder, is that of a file of the clip, or of one being written."""
    folder, slash, last = name.rpartition("/")
    whole = re.fullmatch(r"\.(.*)\.\w+\.tmp", last)
    return _FILES.fullmatch(folder + slash + (whole[1] if whole else last)) is not None


def find_clips(paths: Iterable[Path]) -> list[Path]:
    """Find every clip at or below the paths, each once; the clips of one folder come in the order of their names.

    Hidden folders below a path are left out: a clip that is still being imported lies in one. Raises NteError for a
    path that does not exist, is a file or has no clip in it, and if no path is given.
    """
    found: dict[Path, Path] = {}
    for path in map(Path, paths):
        if not path.is_dir():
            what = "is a file" if path.exists() else "does not exist"
            raise NteError(f"{path}: {what}: expected a clip (a folder with clip.json) or a folder of clips")
        folders = (info.parent for info in path.rglob("clip.json"))
        below = sorted(f for f in folders if not any(name[0] == "." for name in f.relative_to(path).parts))
        if not below:
            raise NteError(f"{path}: no clip in it: expected clip.json, which nte import writes, in or below it")
        for folder in below:
            found.setdefault(folder.resolve(), folder)
    if not found:
        raise NteError("no clips are named: give at least one clip or folder of clips")
    return list(found.values())


def clip_labels(folders: Sequence[Path]) -> list[str]:
    """Make a short unique name for each clip: the folder's name, with its parents if several folders have that name."""
    resolved = [folder.resolve() for folder in folders]
    names = [folder.name for folder in resolved]
    common = Path(os.path.commonpath([folder.parent for folder in resolved])) if resolved else Path()
    return [
        folder.relative_to(common).as_posix() if names.count(folder.name) > 1 else folder.name for folder in resolved
    ]
