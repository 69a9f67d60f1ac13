"""Guides that are turned over against the light are told by name; guides that are right never are."""

from pathlib import Path

import numpy as np
import pytest

from nte.checking import CheckReport, check
from nte.checking.flips import FLIPS, PICTURES
from nte.frames.clip import Clip
from tests.checking.room import room_frame
from tests.synthetic import Pixels, write_clip

HERE = tuple(name for name in PICTURES if name in room_frame(0))
SUN = np.array([0.5, 0.7, -0.5])


def lit(index: int, noise: bool, flat: bool = False) -> dict[str, Pixels]:
    """The room in the sun, with noise of one sample or without; flat: nothing but the light shows the surfaces."""
    frame = room_frame(index)
    sun = np.maximum(np.einsum("i,ihw->hw", SUN, frame["normal"]), 0) + 0.2
    light = 3 * (0.4 if flat else frame["albedo"]) * sun + 0.5 * (frame["depth"] == 0)
    drawn = np.random.default_rng(index).exponential(size=light.shape[1:]) if noise else 1
    return frame | {"color": (light * drawn * np.ones((3, 1, 1))).astype(np.float32)}


def turned(frame: dict[str, Pixels], names: tuple[str, ...], sides: tuple[int, ...]) -> dict[str, Pixels]:
    return frame | {name: np.flip(frame[name], sides) for name in names}


def flips(report: CheckReport) -> dict[str, str]:
    return {f.channel: f.found for f in report.findings if f.found.startswith("shows the picture of")}


@pytest.mark.parametrize("how", FLIPS)
@pytest.mark.parametrize("name", [*HERE, "all"])
def test_a_guide_that_is_turned_over_is_named(tmp_path: Path, name: str, how: str) -> None:
    names = HERE if name == "all" else (name,)
    frames = [turned(lit(i, noise=False), names, FLIPS[how]) for i in range(3)]
    report = check(Clip(write_clip(tmp_path / "clip", frames)))
    assert report.verdict == "implausible"
    assert flips(report) == dict.fromkeys(names, f"shows the picture of color {how}")


def test_motion_that_agrees_with_its_guides_does_not_hide_it(tmp_path: Path) -> None:
    """Everything but the colour comes from another program, whose images begin at the bottom."""
    others = (*HERE, "motion", "position")
    frames = [turned(lit(i, noise=True), others, (-2,)) for i in range(4)]
    for frame in frames:
        frame["motion"] = frame["motion"] * np.float32([[[1]], [[-1]]])
    report = check(Clip(write_clip(tmp_path / "clip", frames)))
    assert "albedo: shows the picture of color upside down" in report.reason


def test_guides_are_not_blamed_for_a_reference_that_is_turned_over(tmp_path: Path) -> None:
    frames = [lit(i, noise=False) | {"reference": lit(i, noise=False)["color"][:, ::-1]} for i in range(3)]
    report = check(Clip(write_clip(tmp_path / "clip", frames)))
    assert flips(report) == {"reference": "shows the picture of color upside down"}


@pytest.mark.parametrize("noise", [False, True])
@pytest.mark.parametrize("flat", [False, True])
def test_nothing_is_said_of_guides_that_are_right(tmp_path: Path, noise: bool, flat: bool) -> None:
    assert not flips(check(Clip(write_clip(tmp_path / "clip", [lit(i, noise, flat) for i in range(3)]))))


def test_a_picture_that_is_its_own_mirror_image_says_nothing(tmp_path: Path) -> None:
    frames = [lit(i, noise=False) for i in range(2)]
    for frame in frames:
        for name in ("color", *HERE):
            half = frame[name][..., :48]
            frame[name] = np.concatenate([half, half[..., ::-1]], -1)
    found = flips(check(Clip(write_clip(tmp_path / "clip", [turned(f, HERE, (-1,)) for f in frames]))))
    assert not found


def test_light_that_has_nothing_to_do_with_the_surfaces_says_nothing(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    frames = [lit(i, noise=False) | {"color": rng.exponential(size=(3, 64, 96)).astype("f")} for i in range(3)]
    assert not flips(check(Clip(write_clip(tmp_path / "clip", frames))))


@pytest.mark.parametrize("size", [(1, 1), (7, 200), (24, 24), (25, 31)])
def test_pictures_of_any_size_are_looked_at(tmp_path: Path, size: tuple[int, int]) -> None:
    rng = np.random.default_rng(3)
    frame = {"color": rng.random((3, *size), np.float32), "albedo": rng.random((3, *size), np.float32)}
    assert not flips(check(Clip(write_clip(tmp_path / "clip", [frame] * 2))))
