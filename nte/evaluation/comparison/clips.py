"""The clips of a comparison: those that its patterns name, before they are rendered and after."""

from collections.abc import Sequence
from fnmatch import fnmatchcase
from pathlib import Path, PurePath

from nte.errors import NteError
from nte.evaluation.comparison.schema import Comparison
from nte.frames.clip import Clip


def is_used(comparison: Comparison, recipe: str, clip: str) -> bool:
    """Say whether a comparison trains on or evaluates a clip, rendered or not.

    recipe: the folder of its recipe below the data's; clip: its own folder below that, such as test/apples_000.
    """
    folder = PurePath(recipe, clip)
    if comparison.networks and not comparison.train:
        return True  # the configurations name their clips by paths of their own
    patterns = [pattern for situation in comparison.situations for pattern in situation.clips]
    return any(_matches(folder, pattern, above=False) for pattern in patterns) or any(
        _matches(folder, train, above=True) for train in comparison.train
    )


def _matches(folder: PurePath, pattern: str, above: bool) -> bool:
    """Say whether a pattern names a folder, or may name it with **; above: or one that the folder lies in."""
    parts, wanted = folder.parts, PurePath(pattern).parts
    for part, name in zip(parts, wanted, strict=False):
        if "**" in name:
            return True
        if not fnmatchcase(part, name):
            return False
    return len(wanted) < len(parts) if above else len(wanted) == len(parts)


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
