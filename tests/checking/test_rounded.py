"""Positions in half floats far from the origin accuse nothing that is right, and what is wrong by more is told."""

from pathlib import Path

import numpy as np
import pytest

from nte.checking import check
from nte.frames.clip import Clip
from tests.checking.room import distances
from tests.checking.test_geometry import FRAMES, cameras
from tests.synthetic import Pixels, write_clip

PLACES = [(0, 0, 0), (60, 60, 60), (300, 0, 100), (0, 0, 1500), (-2000, 100, 500), (9000, 0, 9000)]


def told(folder: Path, place: tuple[float, float, float], change: dict[str, list[Pixels]]) -> dict[str, str]:
    """Findings, by channel, of the room at a place, with positions in half floats."""
    frames = []
    for i, right in enumerate(FRAMES):
        position = np.where(right["depth"] > 0, right["position"] + np.reshape(place, (3, 1, 1)), 0)
        changed = {name: values[i].astype(np.float32) for name, values in change.items()}
        frames.append(right | {"position": position.astype(np.float16).astype(np.float32)} | changed)
    there = np.eye(4)
    there[:3, 3] = np.negative(place)
    given = cameras(lambda view, projection: (view @ there, projection))
    report = check(Clip(write_clip(folder / "clip", frames, cameras=given)))
    return {f.channel: f.found for f in report.findings if f.fault or f.doubt}


@pytest.mark.parametrize("place", PLACES)
def test_rounded_positions_accuse_nothing(tmp_path: Path, place: tuple[float, float, float]) -> None:
    assert not told(tmp_path, place, {})


@pytest.mark.parametrize("place", PLACES[:3])
def test_what_is_wrong_by_more_than_rounding_is_told(tmp_path: Path, place: tuple[float, float, float]) -> None:
    far = told(tmp_path / "depth", place, {"depth": [distances(f) for f in FRAMES]})
    assert "is the distance from the camera" in far["depth"]
    if max(place) <= 60:
        turned = [f["normal"][[0, 2, 1]] for f in FRAMES]
        assert "one rotation of all" in told(tmp_path / "normal", place, {"normal": turned})["normal"]
