"""Whose folder it is: resuming, refusing, and never deleting what is not ours."""

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from nte.errors import NteError
from nte.files import temporary_name
from nte.render.recipes.output import claim, remove_leftovers
from nte.render.recipes.recipe import Group, Recipe

FIRST = Recipe("first", 1, [Group(clips=1)], [])
SECOND = Recipe("second", 1, [Group(clips=1)], [])


def test_an_own_folder_is_claimed_again(tmp_path: Path):
    out = tmp_path / "a" / "out"
    claim(out, FIRST, force=False)
    copy = (out / "recipe.yaml").read_bytes()
    claim(out, FIRST, force=False)
    assert (out / "recipe.yaml").read_bytes() == copy


def test_an_empty_folder_is_claimed(tmp_path: Path):
    claim(tmp_path, FIRST, force=False)
    assert (tmp_path / "recipe.yaml").is_file()


def test_a_foreign_folder_is_refused(tmp_path: Path):
    (tmp_path / "thesis.tex").write_text("x")
    with pytest.raises(NteError, match=r"not empty.*--force"):
        claim(tmp_path, FIRST, force=False)
    assert [p.name for p in tmp_path.iterdir()] == ["thesis.tex"]


def test_a_file_is_refused(tmp_path: Path):
    path = tmp_path / "out"
    path.write_text("x")
    with pytest.raises(NteError, match="is a file"):
        claim(path, FIRST, force=True)


def test_another_recipe_is_refused_unless_forced(tmp_path: Path):
    claim(tmp_path, FIRST, force=False)
    clip = tmp_path / "train" / "rooms_000"
    (clip / "seed_01").mkdir(parents=True)
    for name in ("frame_0000.exr", "seed_01/frame_0000.exr", "clip.json", "notes.txt"):
        (clip / name).write_text("x")
    (tmp_path / "train" / "mine.exr").write_text("x")
    with pytest.raises(NteError, match=r"another recipe.*--force"):
        claim(tmp_path, SECOND, force=False)
    assert (clip / "clip.json").is_file()
    claim(tmp_path, SECOND, force=True)
    left = sorted(p.relative_to(tmp_path).as_posix() for p in tmp_path.rglob("*") if p.is_file())
    assert left == ["recipe.yaml", "train/mine.exr", "train/rooms_000/notes.txt"]
    assert "second" in (tmp_path / "recipe.yaml").read_text()


def stored(out: Path, change: Callable[[str], str]) -> Path:
    """Claim a folder, and change the recipe that is stored there."""
    claim(out, FIRST, force=False)
    copy = out / "recipe.yaml"
    copy.write_text(change(copy.read_text()))
    (out / "train" / "rooms_000").mkdir(parents=True)
    (out / "train" / "rooms_000" / "clip.json").write_text("x")
    return copy


def test_a_key_that_the_stored_recipe_lacks_has_its_default(tmp_path: Path):
    """Clips that were rendered before the key existed are kept; only another value makes it another recipe."""
    copy = stored(tmp_path, lambda text: text.replace("  mirrors: colour\n", ""))
    assert "mirrors" not in (before := copy.read_text())
    claim(tmp_path, FIRST, force=False)
    assert copy.read_text() == before
    with pytest.raises(NteError, match="holds clips of another recipe"):
        claim(tmp_path, Recipe("first", 1, [Group(clips=1, mirrors="black")], []), force=False)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda text: text.replace("mirrors: colour", "polish: 1"), r"cannot read .*'train\[0\]\.polish': unknown key"),
        (lambda text: "name: [", "cannot read .*not readable as YAML"),
        (lambda text: text.replace("by nte", "by nte 0."), "another version of nte"),
        (lambda text: text.replace("# Rendered", "# scene.yaml: 0123456789abcdef\n# Rendered"), "another recipe"),
    ],
)
def test_a_recipe_of_another_version_is_refused_unless_forced(tmp_path: Path, change: Callable[[str], str], said: str):
    copy = stored(tmp_path, change)
    with pytest.raises(NteError, match=f"{said}.*: choose another folder, or --force") as caught:
        claim(tmp_path, FIRST, force=False)
    assert "\n" not in str(caught.value)
    assert (tmp_path / "train" / "rooms_000" / "clip.json").is_file()
    claim(tmp_path, FIRST, force=True)
    assert not (tmp_path / "train" / "rooms_000").exists()
    claim(tmp_path, FIRST, force=False)
    assert "mirrors: colour" in copy.read_text()


@pytest.mark.parametrize("place", ["train", "train/rooms_000", "train/rooms_000/frame_0000.exr", "recipe.yaml"])
def test_nothing_is_written_or_deleted_through_a_link(tmp_path: Path, place: str):
    out, outside = tmp_path / "out", tmp_path / "outside"
    claim(out, FIRST, force=False)
    (outside / "rooms_000").mkdir(parents=True)
    for name in ("rooms_000/frame_0000.exr", "rooms_000/clip.json", "frame_0000.exr", "clip.json"):
        (outside / name).write_text("mine")
    link = out / place
    link.unlink(missing_ok=True)
    link.parent.mkdir(parents=True, exist_ok=True)
    link.symlink_to(outside / "clip.json" if link.suffix else outside)
    for recipe in (FIRST, SECOND):
        with pytest.raises(NteError, match=r"is a link to .*outside.*: nothing is written through links"):
            claim(out, recipe, force=True)
    assert all(path.read_text() == "mine" for path in outside.rglob("*") if path.is_file())
    assert sum(path.is_file() for path in outside.rglob("*")) == 4


def test_what_was_killed_before_it_had_begun_is_taken_up_again(tmp_path: Path):
    (tmp_path / ".recipe.yaml.0a1b2c3d_99_01234567.tmp").write_text("name: fi")
    claim(tmp_path, FIRST, force=False)
    assert "first" in (tmp_path / "recipe.yaml").read_text()


def test_the_same_recipe_keeps_its_clips_even_if_forced(tmp_path: Path):
    claim(tmp_path, FIRST, force=False)
    frame = tmp_path / "train" / "rooms_000" / "frame_0000.exr"
    frame.parent.mkdir(parents=True)
    frame.write_text("x")
    claim(tmp_path, FIRST, force=True)
    assert frame.is_file()


def test_what_killed_writers_left_is_removed_and_what_may_be_written_stays(tmp_path: Path):
    (tmp_path / "seed_01").mkdir()
    abroad = [".frame_0002.exr.0a1b2c3d_99_01234567_01234567.tmp", "seed_01/.frame_0000.exr.0a1b2c3d_99_0_0.tmp"]
    alive = [*abroad, temporary_name(tmp_path / "frame_0003.exr").name]
    kept = [*alive, "clip.json", "frame_0000.exr", "mine.tmp", "seed_01/frame_0000.exr"]
    for name in kept:
        (tmp_path / name).write_text("x")
        os.utime(tmp_path / name, (0, 0))  # on whatever clock: it may jump, and another machine has another one
    ours = [tmp_path / name for name in ("frame_0001.exr", "clip.json", "seed_01/frame_0000.exr")]
    code = "import sys; from pathlib import Path; from nte.files import temporary_name as name; "
    code += "[name(Path(path)).touch() for path in sys.argv[1:]]"
    subprocess.run([sys.executable, "-c", code, *map(str, ours)], check=True)
    assert len(list(tmp_path.rglob("*.tmp"))) == len(alive) + 1 + len(ours)
    remove_leftovers(tmp_path)
    assert {p.relative_to(tmp_path).as_posix() for p in tmp_path.rglob("*") if p.is_file()} == set(kept)
