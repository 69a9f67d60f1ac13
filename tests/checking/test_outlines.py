"""Depth of another clip is in doubt without positions and cameras: it steps where nothing else changes."""

from pathlib import Path

import numpy as np
import pytest

from nte.checking import CheckReport, check
from nte.checking.outlines import OutlineTally
from nte.frames.clip import Clip
from nte.frames.frame import Frame
from tests.checking.room import room_frame
from tests.synthetic import Pixels, disc_frame, write_clip

WALLS = {"velocity": (5.0, -2.0), "wall_velocity": (-3.0, 1.5), "size": (64, 96)}
RIGHT = [disc_frame(i, **WALLS) for i in range(4)]  # type: ignore[arg-type]
OTHER = [disc_frame(i, **WALLS, start=(60.0, 40.0), radius=14.0) for i in range(4)]  # type: ignore[arg-type]


def checked(folder: Path, depths: list[dict[str, Pixels]], without: tuple[str, ...] = ()) -> CheckReport:
    frames = [right | {"depth": other["depth"]} for right, other in zip(RIGHT, depths, strict=True)]
    frames = [{name: values for name, values in frame.items() if name not in without} for frame in frames]
    return check(Clip(write_clip(folder / "clip", frames)))


@pytest.mark.parametrize("without", [(), ("instance",), ("normal",)])
def test_the_depth_of_another_clip_is_a_doubt(tmp_path: Path, without: tuple[str, ...]) -> None:
    report = checked(tmp_path, OTHER, without)
    assert report.verdict == "undecidable"
    assert "of its steps albedo" in report.reason
    assert not [f for f in report.findings if f.channel == "depth" and f.fault]


@pytest.mark.parametrize("without", [(), ("instance",), ("normal",)])
def test_nothing_is_said_of_right_depth(tmp_path: Path, without: tuple[str, ...]) -> None:
    assert not [f for f in checked(tmp_path, RIGHT, without).findings if f.channel == "depth"]


def told(frames: list[dict[str, Pixels]]) -> list[str]:
    tally = OutlineTally()
    for i, frame in enumerate(frames):
        right = {name: np.ascontiguousarray(values[None], np.float32) for name, values in frame.items()}
        tally.add(Frame(right, i).torch())
    return [finding.found for finding in tally.judge()]


def test_nothing_is_said_of_slopes_and_skies() -> None:
    """The ground of the room is steep towards its horizon, and ends there."""
    frames = [room_frame(i) for i in range(4)]
    assert not told(frames)
    assert told([frame | {"depth": frame["depth"][:, ::-1]} for frame in frames])


def test_steps_of_one_material_tell_nothing() -> None:
    """Terraces seen from above: depth is all that changes."""
    _, x = np.mgrid[:64, :96]
    flat = np.ones((3, 64, 96))
    frame = {"depth": (2.0 + 2 * (x // 12 % 2))[None], "albedo": 0.5 * flat, "normal": flat / 3**0.5}
    assert not told([frame] * 4)


def test_sizes_of_one_pixel_tell_nothing() -> None:
    for size in ((1, 1), (1, 9), (9, 1)):
        assert not told([disc_frame(i, size=size) for i in range(4)])
