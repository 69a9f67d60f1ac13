"""The folder that a recipe is rendered into: which recipe owns it, and which frames in it are done."""

import re
from pathlib import Path

from nte.errors import NteError
from nte.files import refuse_links, sweep, write_whole
from nte.frames.clip import frame_path, read_frame
from nte.render.recipes.recipe import SHARP, SPLITS, ClipPlan, Recipe, recipe_text

_BEGUN = re.compile(r"\.recipe\.yaml\.\w+\.tmp")  # left by a process that was killed before its first rendering
_OURS = re.compile(r"(seed_\d{2}/)?(\.?frame_\d{4}\.exr(\.\w+\.tmp)?|\.?clip\.json(\.\w+\.tmp)?)")


def claim(out: Path, recipe: Recipe, force: bool, folder: Path = Path()) -> None:
    """Make `out` the folder of this recipe, and keep the frames that an earlier run has left there.

    folder: the folder of the recipe's file. Raises NteError for a folder that holds another recipe's clips, anything
    else, or links. force: remove the other recipe's clips instead; files that are not ours stay.
    """
    text, copy = recipe_text(recipe, folder), out / "recipe.yaml"
    if out.exists() and not out.is_dir():
        raise NteError(f"{out}: is a file: expected a folder for the clips")
    found = copy.read_text(encoding="utf-8") if copy.is_file() else None
    sweep(out)
    refuse_links(out)
    if found != text:
        if not force and out.exists() and any(not _BEGUN.fullmatch(path.name) for path in out.iterdir()):
            what = "holds clips of another recipe, or of another version of nte" if found else "is not empty"
            raise NteError(f"{out}: {what}: choose another folder, or --force")
        if found is not None:
            _remove_clips(out)
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise NteError(f"{out}: cannot be made: {error.strerror}") from error
    if found != text:
        write_whole(copy, lambda temporary: temporary.write_text(text, encoding="utf-8") and None)


def is_whole(path: Path, channels: tuple[str, ...], plan: ClipPlan) -> bool:
    """Say whether a frame's file can be read and has these channels in the planned size."""
    try:
        found = read_frame(path)
    except NteError:
        return False
    size = plan.group.height, plan.group.width
    return all(name in found and found[name].shape[1:] == size for name in channels)


def files_of(folder: Path, index: int, seeds: int) -> list[Path]:
    """Return the files of a frame: the first has all channels, those of further seeds only the noisy ones."""
    return [frame_path(folder, index, seed) for seed in range(seeds)]


def remove_leftovers(clip: Path) -> None:
    """Delete the temporary files that killed writers have left beside the frames of a clip that is now complete."""
    for path in clip.rglob("*.tmp"):
        if _OURS.fullmatch(path.relative_to(clip).as_posix()):
            path.unlink(missing_ok=True)


def _remove_clips(out: Path) -> None:
    """Delete the clips below `out`: only files and folders with the names that nte render gives them."""
    for split in (*SPLITS, *(f"{SHARP}/{split}" for split in SPLITS)):
        for clip in sorted((out / split).glob("*_[0-9][0-9][0-9]*")):
            for path in sorted(clip.rglob("*"), reverse=True):
                if path.is_file() and _OURS.fullmatch(path.relative_to(clip).as_posix()):
                    path.unlink()
            for folder in [*sorted(clip.glob("seed_[0-9][0-9]")), clip]:
                if folder.is_dir() and not any(folder.iterdir()):
                    folder.rmdir()
