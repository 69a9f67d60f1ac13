"""Depth in another unit in every frame is told by vectors, whatever moves; what a camera does is no other unit."""

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import torch

from nte.checking import check
from nte.checking.units import judge_units, unit_of
from nte.frames.clip import Clip
from nte.frames.frame import Frame
from nte.frames.sample import spread
from tests.checking.room import SIZE, room_frame
from tests.checking.tiles import tiled_frame
from tests.synthetic import Pixels, smooth_texture, write_clip

Shot = dict[str, Pixels]


def hall_frame(index: int) -> Shot:
    """A floor, a far wall and a wall to the right, along which a camera travels."""
    y, x = np.mgrid[: SIZE[0], : SIZE[1]] + 0.5
    ray = np.stack([(x - 40) / 70, (y - 30) / 70, 0 * x + 1])
    travel = np.array([0.1, 0.02, 0.2]).reshape(3, 1, 1)
    place = travel[:, 0, 0] * index
    down, right = (np.where(slope > 0, slope, 1e-9) for slope in (ray[1], ray[0]))
    depth = np.minimum.reduce([(1.5 - place[1]) / down, 8 - place[2] + 0 * x, (2.5 - place[0]) / right])
    before = depth * ray + travel
    motion = 70 * (before[:2] / before[2] - ray[:2])
    texture = smooth_texture(*(9 * (depth * ray + place.reshape(3, 1, 1))[i] for i in (0, 2)))
    channels = {"depth": depth[None], "motion": motion, "albedo": texture, "color": texture}
    return {name: values.astype(np.float32) for name, values in channels.items()}


SHOTS = [hall_frame, lambda i: tiled_frame(i, "photo", 1)]
IDS = ["travels", "at rest"]


def ratios(frames: list[Shot]) -> list[float]:
    given = [
        Frame({name: torch.tensor(frame[name])[None] for name in ("depth", "motion")}, i)
        for i, frame in enumerate(frames)
    ]
    return [ratio for pair in pairwise(given) if (ratio := unit_of(*pair)) is not None]


@pytest.mark.parametrize("shot", SHOTS, ids=IDS)
def test_one_unit_is_one(shot: Callable[[int], Shot]) -> None:
    found = ratios([shot(i) for i in range(4)])
    assert found == pytest.approx([1, 1, 1], abs=0.02)
    assert not list(judge_units(found))


@pytest.mark.parametrize("shot", SHOTS, ids=IDS)
def test_a_unit_of_its_own_in_every_frame_is_a_fault(shot: Callable[[int], Shot]) -> None:
    frames = [shot(i) for i in range(4)]
    for i, frame in enumerate(frames):
        frame["depth"] = frame["depth"] * np.float32([1, 2, 0.5, 3][i])
    found = ratios(frames)
    assert found == pytest.approx([2, 0.25, 6], rel=0.03)
    (finding,) = judge_units(found)
    assert finding.fault
    assert finding.found.endswith(" times as large as in the frame before, in 3 of 3 frames that tell")
    assert [finding.fault for finding in judge_units([1.0, 2.0, 1.0])] == [False]


def test_one_change_of_unit_is_a_fault_if_the_vectors_are_confirmed() -> None:
    """At a cut they never are."""
    assert [finding.fault for finding in judge_units([1.0, 100.0, 1.0], confirmed=[1.0, 100.0])] == [True]
    assert [finding.fault for finding in judge_units([1.0, 1.5, 1.0], confirmed=[1.5])] == [False]


@pytest.mark.parametrize("shot", SHOTS, ids=IDS)
def test_a_clip_with_units_of_its_own_in_every_frame_fails(tmp_path: Path, shot: Callable[[int], Shot]) -> None:
    """Depth is blamed, and not the vectors of what is at rest."""
    frames = [shot(i) for i in range(3)]
    for i, frame in enumerate(frames):
        frame["depth"] = frame["depth"] * np.float32(1 + 0.3 * (i % 2))
    report = check(Clip(write_clip(tmp_path / "clip", frames)))
    assert report.verdict == "implausible"
    assert report.reason.startswith("depth: 0.769 to 1.3 times as large as in the frame before")
    assert "vectors" not in report.reason


def test_one_plane_tells_no_unit() -> None:
    """The ball before it is too small."""
    assert ratios([room_frame(i) for i in range(3)]) == []


@pytest.mark.parametrize("size", [(1, 1), (2, 3), SIZE])
def test_what_has_one_depth_or_hardly_any_pixels_tells_nothing(size: tuple[int, int]) -> None:
    frame = {"depth": np.full((1, *size), 5, np.float32), "motion": np.full((2, *size), 0.7, np.float32)}
    assert ratios([frame, frame | {"depth": 2 * frame["depth"]}]) == []


def test_what_goes_wrong_at_the_end_of_a_clip_is_seen(tmp_path: Path) -> None:
    """Four frames are looked at, and not the first four."""
    frames = [room_frame(i / 4) for i in range(9)]
    for frame in frames[3:]:
        frame["normal"] = frame["normal"][[0, 2, 1]]
    report = check(Clip(write_clip(tmp_path / "clip", frames)))
    assert any(f.channel == "normal" and "perpendicular" in f.found for f in report.findings)


@pytest.mark.parametrize(
    ("first", "end", "chosen"),
    [(0, 0, []), (0, 1, [0]), (1, 3, [1, 2]), (0, 10, [0, 3, 6, 9]), (1, 100, [1, 34, 66, 99])],
)
def test_frames_are_spread_from_first_to_last(first: int, end: int, chosen: list[int]) -> None:
    assert sorted(spread(4, first, end)) == chosen


def floor_frame(index: int, travel: float, drift: float) -> Shot:
    """A floor that a camera flies over, and a third of the picture full of boards, which move towards it."""
    y, x = np.mgrid[: SIZE[0], : SIZE[1]] + 0.5
    ray = np.stack([(x - 48) / 70, (y + 20) / 70, 0 * x + 1])
    board = (x.astype(int) // 16) % 3 == 0
    depth = np.where(board, 1.2 + 0.01 * (x // 16) - drift * index, 1.5 / ray[1])
    step = np.where(board, drift, travel)
    before = depth * ray + np.stack([0 * x, 0 * x, step])
    channels = {"depth": depth[None], "motion": 70 * (before[:2] / before[2] - ray[:2])}
    return {name: values.astype(np.float32) for name, values in channels.items()}


@pytest.mark.parametrize(("travel", "drift"), [(0.02, 0.2), (0.1, 0.3), (0.3, -0.1), (0.0, 0.05)])
def test_what_moves_before_a_floor_says_nothing_of_its_unit(travel: float, drift: float) -> None:
    """The floor alone is one plane, whatever was left out of it."""
    assert not list(judge_units(ratios([floor_frame(i, travel, drift) for i in range(4)])))
