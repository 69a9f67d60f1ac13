"""The pictures of `nte check --picture`: one for each clip that has one, under names of their own."""

from pathlib import Path

import numpy as np
import pytest
import torch

from nte.checking.show import typical_length
from nte.cli import main
from nte.cli.check import picture_names
from nte.errors import NteError
from tests.synthetic import disc_clip, write_clip


def test_the_clip_here_and_clips_of_one_name_have_pictures_of_their_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shots = [disc_clip(tmp_path / day / "shots" / "disc", frames=2, size=(16, 24)) for day in ("monday", "tuesday")]
    monkeypatch.chdir(shots[0])
    main(["check", ".", "../../../tuesday", "--picture", str(tmp_path / "pictures")])
    names = {"monday_shots_disc.png", "tuesday_shots_disc.png"}
    assert {path.name for path in (tmp_path / "pictures").iterdir()} == names
    main(["check", ".", "--picture", str(tmp_path / "alone")])
    assert [path.name for path in (tmp_path / "alone").iterdir()] == ["shots_disc.png"]


def test_two_paths_that_make_one_name_are_refused() -> None:
    assert picture_names([Path("/a/b/c"), Path("/d/b/c"), Path("/d/e/f")]) == ["a_b_c.png", "d_b_c.png", "e_f.png"]
    with pytest.raises(NteError, match=r"^/a_b/c and /a/b_c: the picture of each would be a_b_c\.png: check them one"):
        picture_names([Path("/a_b/c"), Path("/a/b_c")])


def test_vectors_of_a_large_image_have_a_typical_length() -> None:
    motion = torch.zeros(1, 2, 1, 2**24 + 1)  # more than PyTorch's quantile takes: an image of 8K has 33 million
    motion[0, :, 0, : 2**20] = torch.tensor([[3.0], [-4.0]])
    motion[0, 0, 0, 0] = torch.nan
    assert typical_length(motion) == 5


def test_a_clip_with_nothing_to_draw_stops_nobody(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bare = {"color": np.ones((3, 8, 8), np.float32)}
    write_clip(tmp_path / "clips" / "a_bare", [bare] * 2)
    write_clip(tmp_path / "clips" / "b_short", [bare | {"albedo": bare["color"]}])
    disc_clip(tmp_path / "clips" / "c_disc", frames=2, size=(16, 24))
    main(["check", str(tmp_path / "clips"), "--picture", str(tmp_path / "pictures")])
    said = capsys.readouterr().out
    assert "no picture: the clip has no albedo and no motion" in said
    assert "no picture: the clip has one frame, expected two" in said
    assert [path.name for path in (tmp_path / "pictures").iterdir()] == ["clips_c_disc.png"]


def test_a_picture_that_is_there_is_refused_before_the_check(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    disc_clip(tmp_path / "clips" / "disc", frames=2, size=(16, 24))
    given = ["check", str(tmp_path / "clips"), "--picture", str(tmp_path / "pictures")]
    main(given)
    first = capsys.readouterr().out
    main(given)
    again = capsys.readouterr()
    assert again.out == ""
    assert "clips_disc.png: exists" in again.err
    (tmp_path / "pictures" / "clips_disc.png").write_text("older")
    main([*given, "--force"])
    assert capsys.readouterr().out == first
    assert (tmp_path / "pictures" / "clips_disc.png").stat().st_size > 100
