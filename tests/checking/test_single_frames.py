"""Vectors of single frames that differ from the rest are told as such: lost or negated ones, and cuts."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from nte.checking import CheckReport, check
from nte.frames.clip import Clip
from tests.synthetic import Pixels, disc_frame, smooth_texture, write_clip

MOVING = {"velocity": (5.0, -2.0), "wall_velocity": (-3.0, 1.5), "size": (64, 96)}
SLOW = {"velocity": (1.3, 0.2), "wall_velocity": (1.3, 0.2), "size": (64, 96)}
FRAMES = [disc_frame(i, **MOVING) for i in range(8)]  # type: ignore[arg-type]
MOTION = "motion"


def checked(folder: Path, change: Callable[[Pixels, int], Pixels], frames: list[dict[str, Pixels]]) -> CheckReport:
    changed = [frame | {MOTION: np.float32(change(frame[MOTION], i))} for i, frame in enumerate(frames)]
    bare = [{name: values for name, values in frame.items() if name != "forward_motion"} for frame in changed]
    return check(Clip(write_clip(folder / "clip", bare)))


@pytest.mark.parametrize("first", [0, 1])
@pytest.mark.parametrize(
    ("factor", "told"), [(0, "it is 0 there, and the picture moves"), (-1, "another convention there: sign (they are")]
)
def test_vectors_that_are_lost_or_negated_in_every_second_frame(
    tmp_path: Path, factor: int, told: str, first: int
) -> None:
    """No convention of the whole clip: in the other frames they are right."""
    report = checked(tmp_path, lambda m, i: m * (factor if i % 2 == first else 1), FRAMES)
    assert report.verdict == "implausible"
    where = f"in {3 + first} of 7 frames that were judged, the first is {2 - first}"
    assert report.reason.startswith(f"'motion' is of another kind {where}: ")
    assert told in report.reason
    assert report.convention is None


def other_shot(index: int) -> dict[str, Pixels]:
    """A wall of another texture that moves otherwise."""
    frame = disc_frame(index, radius=0, wall_velocity=(2.0, 2.5), size=(64, 96))
    y, x = np.mgrid[:64, :96] + 0.5
    albedo = smooth_texture(2.1 * (x - 2 * index), 1.7 * (y - 2.5 * index), phase=1.0)
    return frame | {"albedo": albedo, "color": 2 * albedo, "reference": 2 * albedo}


@pytest.mark.parametrize("without", [(), ("depth", "instance")])
def test_a_cut_is_noted(tmp_path: Path, without: tuple[str, ...]) -> None:
    cut = FRAMES[:4] + [other_shot(i) for i in range(4, 8)]
    frames = [{name: values for name, values in frame.items() if name not in without} for frame in cut]
    report = checked(tmp_path, lambda m, i: m, frames)
    assert report.verdict == "plausible"
    told = [finding.found for finding in report.findings if finding.channel == MOTION]
    assert told == [
        "finds hardly anything of the frame before in 1 of 7 frames that were judged, the first is 4: a cut, or lost "
        "vectors"
    ]


def test_no_cut_is_told_in_one_shot(tmp_path: Path) -> None:
    report = checked(tmp_path, lambda m, i: m, FRAMES)
    assert not [finding for finding in report.findings if finding.channel == MOTION]


@pytest.mark.parametrize("lost", [(3,), (2, 5)])
def test_short_vectors_that_are_lost_in_single_frames_are_noted(tmp_path: Path, lost: tuple[int, ...]) -> None:
    """They are too short for contradictions."""
    frames = [disc_frame(i, **SLOW) for i in range(8)]  # type: ignore[arg-type]
    report = checked(tmp_path, lambda m, i: m * (i not in lost), frames)
    told = {finding.found for finding in report.findings if finding.channel == MOTION}
    where = f"in {len(lost)} of 7 frames, the first is {lost[0]}"
    assert f"0 everywhere {where}, though the picture changes as it does where it is not" in told


def test_a_camera_that_rests_has_lost_no_vectors(tmp_path: Path) -> None:
    places = [0, 1, 2, 2, 2, 3, 4, 5]
    frames = [disc_frame(place, **SLOW) for place in places]  # type: ignore[arg-type]
    report = checked(tmp_path, lambda m, i: m * (i not in (3, 4)), frames)
    assert not [finding for finding in report.findings if finding.channel == MOTION]
