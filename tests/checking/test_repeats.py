"""A noisy image that is exactly that of the frame before is noted, and so is one albedo for all surfaces."""

from pathlib import Path

import numpy as np
import pytest

from nte.checking import check
from nte.frames.clip import Clip
from tests.checking.test_late import SHOTS, noisy
from tests.synthetic import write_clip

FRAMES = [SHOTS[i] | {"color": noisy(SHOTS[i]["color"], i)} for i in range(5)]


def told(folder: Path, kept: dict[int, int]) -> list[str]:
    frames = [frame | {"color": FRAMES[kept.get(i, i)]["color"]} for i, frame in enumerate(FRAMES)]
    report = check(Clip(write_clip(folder / "clip", frames)))
    return [f.found for f in report.findings if f.channel == "color" and not f.fault and not f.doubt]


@pytest.mark.parametrize(
    ("kept", "where"), [({3: 2}, "1 of 4 frames, the first is 3"), (dict.fromkeys(range(5), 0), "4 of 4 frames")]
)
def test_a_frame_that_was_kept_is_noted(tmp_path: Path, kept: dict[int, int], where: str) -> None:
    (found,) = told(tmp_path, kept)
    assert found.startswith(f"is the same image as in the frame before in {where}")


def test_nothing_is_said_of_new_noise_and_of_black_frames(tmp_path: Path) -> None:
    assert told(tmp_path / "a", {}) == []
    dark = [frame | {"color": 0 * frame["color"]} if i else frame for i, frame in enumerate(FRAMES)]
    report = check(Clip(write_clip(tmp_path / "b", dark)))
    assert not [f for f in report.findings if "same image" in f.found]


@pytest.mark.parametrize("value", [0.25, 1.0])
def test_one_albedo_for_all_is_noted(tmp_path: Path, value: float) -> None:
    """Engines without that pass write white, or grey."""
    frames = [frame | {"albedo": np.full_like(frame["albedo"], value)} for frame in FRAMES]
    report = check(Clip(write_clip(tmp_path / "clip", frames)))
    assert [f.found for f in report.findings if f.channel == "albedo"] == [f"{value:g} everywhere"]
