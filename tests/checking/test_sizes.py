"""Pictures of any size are checked, and right ones accuse nothing: a pixel, two by two, odd ones, a single row."""

from pathlib import Path

import pytest

from nte.checking import check, describe
from nte.frames.clip import Clip
from tests.synthetic import disc_clip


@pytest.mark.parametrize("size", [(1, 1), (2, 2), (3, 5), (1, 40), (7, 9)])
@pytest.mark.parametrize("frames", [1, 2, 3])
def test_a_tiny_picture_is_checked(tmp_path: Path, size: tuple[int, int], frames: int) -> None:
    clip = Clip(disc_clip(tmp_path / "clip", frames, seed=0, size=size, start=(2.0, 2.0), radius=2.0))
    report = check(clip)
    assert report.verdict == "undecidable"
    assert not [finding for finding in report.findings if finding.fault or finding.doubt]
    assert describe(report).startswith("clip: undecidable")
