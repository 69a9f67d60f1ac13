"""Silhouettes alone prove no convention: hundreds of thin parts without texture, a sky that moves more than they do."""

from pathlib import Path

import numpy as np
import pytest

from nte.checking import check
from nte.frames.clip import Clip
from tests.checking.thin import thin_frames
from tests.synthetic import write_clip


@pytest.mark.parametrize("size", [(120, 160), pytest.param((480, 640), marks=pytest.mark.slow)])
@pytest.mark.parametrize("travel", [0.0, 0.8])
def test_right_vectors_of_thin_parts_never_fail(tmp_path: Path, size: tuple[int, int], travel: float) -> None:
    report = check(Clip(write_clip(tmp_path / "clip", thin_frames(3, size, travel=travel))))
    assert report.verdict != "implausible", report.reason
    assert not report.votes.against


def test_thin_parts_that_move_far_tell_a_wrong_sign(tmp_path: Path) -> None:
    frames = thin_frames(3, (120, 160), travel=8.0)
    assert check(Clip(write_clip(tmp_path / "right", frames))).verdict == "plausible"
    for frame in frames:
        frame["motion"] = -frame["motion"]
    report = check(Clip(write_clip(tmp_path / "wrong", frames)))
    assert report.verdict == "implausible"
    assert "sign" in report.reason


def test_thin_parts_that_move_without_vectors(tmp_path: Path) -> None:
    frames = thin_frames(3, (120, 160), travel=8.0)
    for frame in frames:
        frame["motion"] = np.zeros_like(frame["motion"])
    report = check(Clip(write_clip(tmp_path / "clip", frames)))
    assert report.verdict == "implausible"
    assert "the picture changes and the vectors do not" in report.reason


@pytest.mark.parametrize("travel", [0.4, 1.0, 8.0])
def test_right_vectors_of_thin_parts_in_albedo_alone_never_fail(tmp_path: Path, travel: float) -> None:
    """Without instances and depth, the vectors themselves tell where parts end before the sky."""
    frames = [{n: f[n] for n in ("color", "albedo", "motion")} for f in thin_frames(3, (120, 160), travel=travel)]
    report = check(Clip(write_clip(tmp_path / "clip", frames)))
    assert report.verdict != "implausible", report.reason
