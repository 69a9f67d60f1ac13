"""The clips of a comparison: those that its patterns name among the rendered ones."""

from collections.abc import Sequence
from pathlib import Path

from nte.errors import NteError
from nte.frames.clip import Clip


def matching_clips(patterns: Sequence[str], data: Path, where: str) -> list[Path]:
    """Find the finished clips, folders with clip.json, that the patterns name below `data`, each once.

    Sharp twins of blurred clips lie below sharp/, where patterns such as test/fence_* do not reach. where: what has the
    patterns, for errors. Raises NteError for a pattern without clips, and for one that leads out of the folder.
    """
    found: list[Path] = []
    for pattern in patterns:
        try:
            if ".." in Path(pattern).parts:
                raise ValueError("it leads out of it")
            matching = sorted(folder for folder in data.glob(pattern) if (folder / "clip.json").is_file())
        except (ValueError, NotImplementedError, IndexError) as error:  # empty, absolute, «.», a ** within a word
            raise NteError(f"'{pattern}' of {where} is no pattern below {data}: {error}") from error
        if not matching:
            raise NteError(f"{data}: no finished clip matches '{pattern}' of {where}")
        found += matching
    return list(dict.fromkeys(found))


def require_same_channels(clips: Sequence[Path], where: str) -> None:
    """Raise NteError for the first clip whose channels differ from those of the first clip."""
    first, *others = (Clip(folder) for folder in clips)
    for other in others:
        if difference := {*first.channels} ^ {*other.channels}:
            name = min(difference)
            has, lacks = (first, other) if name in first.channels else (other, first)
            raise NteError(
                f"{where}: {lacks.folder} has no channel '{name}', which {has.folder} has: compare clips with the same "
                "channels"
            )
