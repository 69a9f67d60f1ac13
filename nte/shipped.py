"""The configurations, comparisons and recipes that come with nte, by the names that they have in its repository."""

import os
from pathlib import Path

FOLDERS = ("configs", "datasets")
# os.path.exists: unlike Path.exists it is false for a name that is too long for any file.
_HERE = Path(__file__).parent
_PLACES = _HERE, _HERE.parent  # an installed package has them inside, a clone beside it


def shipped(path: Path) -> Path:
    """Return the file that ships with nte if the path, such as configs/quickstart.yaml, names one and does not exist.

    Every other path is returned as it is.
    """
    if os.path.exists(path) or path.parts[:1] not in [(folder,) for folder in FOLDERS] or ".." in path.parts:
        return path
    return next((place / path for place in _PLACES if (place / path).is_file()), path)


def beside(path: Path, named: str) -> Path:
    """Return the file that another file names: the one at that place relative to it, or else one that ships."""
    near = path.parent / named
    found = near if os.path.exists(near) else shipped(Path(named))
    return found if os.path.exists(found) else near
