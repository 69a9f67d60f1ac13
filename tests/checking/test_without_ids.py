"""Clips as most engines write them: no instances, and objects that stand close before their background."""

from pathlib import Path

import numpy as np
import pytest

from nte.checking import check
from nte.frames.clip import Clip
from tests.synthetic import Pixels, disc_frame, write_clip

SIZE = 120, 160


def close_before_a_wall(velocity: tuple[float, float], nearer: float) -> list[dict[str, Pixels]]:
    """A disc before a wall at rest, whose depth is `nearer` times that of the disc."""
    frames = []
    for index in range(4):
        frame = disc_frame(index, SIZE, velocity, start=(45.0, 50.0), radius=26.0)
        frame["depth"] = np.where(frame["instance"] == 2, 5 / nearer, 5).astype(np.float32)
        frames.append({name: frame[name] for name in ("color", "albedo", "depth", "motion")})
    return frames


@pytest.mark.parametrize(("velocity", "nearer"), [((7.0, 0.0), 1.4), ((9.0, 4.0), 1.12), ((-3.0, 8.0), 1.25)])
def test_uncovered_background_contradicts_nothing(tmp_path: Path, velocity: tuple[float, float], nearer: float) -> None:
    report = check(Clip(write_clip(tmp_path / "clip", close_before_a_wall(velocity, nearer))))
    assert report.verdict == "plausible"
    assert not report.votes.against


@pytest.mark.parametrize(("wrong", "named"), [(-1.0, "sign (they are negated"), (1 / 160, "unit (uv")])
def test_the_plain_convention_is_named(tmp_path: Path, wrong: float, named: str) -> None:
    frames = close_before_a_wall((9.0, 4.0), 1.3)
    for frame in frames:
        frame["motion"] *= np.reshape([wrong, wrong * (1 if wrong < 0 else 160 / 120)], (2, 1, 1)).astype(np.float32)
    report = check(Clip(write_clip(tmp_path / "clip", frames)))
    assert report.verdict == "implausible"
    assert report.reason.startswith(f"'motion' has another convention: {named}")
    assert "forward" not in report.reason.partition(": it explains")[0]


@pytest.mark.parametrize(
    ("velocity", "unit"), [((0.9, 0.5), 64.0), ((-0.9, 0.5), 64.0), ((0.9, -0.5), 1e4), ((-0.6, -0.3), -64.0)]
)
def test_vectors_without_length_confirm_nothing(tmp_path: Path, velocity: tuple[float, float], unit: float) -> None:
    """A slow picture, and vectors of another unit: most of them lead to the side to which the picture moves."""
    frames = [disc_frame(i, SIZE, velocity, velocity, radius=9.0) for i in range(3)]
    for frame in frames:
        del frame["forward_motion"]
        frame["motion"] /= unit
    report = check(Clip(write_clip(tmp_path / "clip", frames)))
    assert report.verdict != "plausible"
    assert not report.votes.good
