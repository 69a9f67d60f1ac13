"""The names of a clip's files, by which commands tell what they may replace."""

from pathlib import Path

import pytest

from nte.files import temporary_name
from nte.frames.clip_files import frame_path, is_clip_file


@pytest.mark.parametrize(("index", "seed"), [(0, 0), (9999, 0), (12345, 0), (7, 1), (7, 99)])
def test_frames_of_a_clip_are_its_files_also_while_they_are_written(index: int, seed: int, tmp_path: Path) -> None:
    path = frame_path(tmp_path, index, seed)
    for name in (path, temporary_name(path)):
        assert is_clip_file(name.relative_to(tmp_path).as_posix())


@pytest.mark.parametrize(
    "name",
    [
        *("notes.txt", "frame_0001.png", "frame_01.exr", "clip.json.bak", "seed_01/notes.txt", "seed_1/frame_0001.exr"),
        *("other/frame_0001.exr", ".frame_0001.exr", ".mine.tmp", "frame_0001.exr.tmp", "a/seed_01/frame_0001.exr"),
    ],
)
def test_what_somebody_else_put_there_is_none(name: str) -> None:
    assert not is_clip_file(name)
