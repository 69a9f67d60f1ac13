"""The folder that a recipe is rendered into: which recipe owns it, and which frames in it are done."""

import re
from contextlib import suppress
from pathlib import Path

from nte.config import load_config, to_yaml
from nte.errors import NteError
from nte.files import is_abandoned, make_folder, refuse_links, sweep, write_whole
from nte.frames.clip import read_frame
from nte.frames.clip_files import frame_path, is_clip_file
from nte.render.recipes.recipe import SHARP, SPLITS, ClipPlan, Recipe, recipe_text

_BEGUN = re.compile(r"\.recipe\.yaml\.\w+\.tmp")  # left by a process that was killed before its first rendering


def claim(out: Path, recipe: Recipe, force: bool, folder: Path = Path()) -> None:
    """Make `out` the folder of this recipe, and keep the frames that an earlier run has left there.

    folder: the folder of the recipe's file. Raises NteError for a folder that holds another recipe's clips, anything
    else, or links. force: remove the other recipe's clips instead; files that are not ours stay.
    """
    text, copy = recipe_text(recipe, folder), out / "recipe.yaml"
    if out.exists() and not out.is_dir():
        raise NteError(f"{out}: is a file: expected a folder for the clips")
    sweep(out)
    refuse_links(out)
    what = _difference(copy, text) if copy.is_file() else "is not empty"
    if not what:
        return
    if not force and out.exists() and any(not _BEGUN.fullmatch(path.name) for path in out.iterdir()):
        raise NteError(f"{out}: {what}: choose another folder, or --force")
    if copy.is_file():
        _remove_clips(out)
    make_folder(out)
    write_whole(copy, lambda temporary: temporary.write_text(text, encoding="utf-8"))


def _difference(copy: Path, text: str) -> str:
    """Say how the recipe that a folder's clips were rendered from differs from `text`; "" if both give the same clips.

    A key that did not exist yet when the clips were rendered has its default.
    """
    comments = [line for line in copy.read_text(encoding="utf-8", errors="replace").splitlines() if line[:1] == "#"]
    try:
        before = "\n".join([*comments, to_yaml(load_config(Recipe, copy))])
    except NteError as error:
        return f"holds clips of a recipe that this version of nte cannot read ({error})"
    return "" if before == text else "holds clips of another recipe, or of another version of nte"


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
    """Delete the temporary files that killed writers have left beside the frames of a clip that is now complete.

    A worker of a cluster whose client was killed may still write the same frames as one of the next client. So a file
    stays if its writer may be alive, as any on another machine may: by the time of a file nobody could tell, since two
    machines have two clocks. It goes when a clip here is completed by a process of that machine.
    """
    for path in clip.rglob("*.tmp"):
        if is_clip_file(path.relative_to(clip).as_posix()):
            with suppress(FileNotFoundError):  # its writer has renamed it
                if is_abandoned(path):
                    path.unlink()


def _remove_clips(out: Path) -> None:
    """Delete the clips below `out`: only files and folders with the names that nte render gives them."""
    for split in (*SPLITS, *(f"{SHARP}/{split}" for split in SPLITS)):
        for clip in sorted((out / split).glob("*_[0-9][0-9][0-9]*")):
            for path in sorted(clip.rglob("*"), reverse=True):
                if path.is_file() and is_clip_file(path.relative_to(clip).as_posix()):
                    path.unlink()
            for folder in [*sorted(clip.glob("seed_[0-9][0-9]")), clip]:
                if folder.is_dir() and not any(folder.iterdir()):
                    folder.rmdir()
