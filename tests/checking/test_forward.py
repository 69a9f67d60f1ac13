"""Forward vectors must lead back to where the vectors of the next frame come from."""

from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from nte.checking import check
from nte.checking.forward import Returns
from nte.checking.pairs import PairTally
from nte.frames.clip import Clip
from tests.checking.room import room_frame, seen
from tests.synthetic import Pixels, disc_frame, smooth_texture, write_clip

MOVING = {"velocity": (5.0, -2.0), "wall_velocity": (-3.0, 1.5), "size": (64, 96)}
FRAMES = [disc_frame(i, **MOVING) for i in range(4)]  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda forward: 0 * forward, "0 where motion is not, in 100% of the moving pixels"),
        (lambda forward: -forward, "has another convention: sign (they are negated"),
        (lambda forward: forward / np.reshape([96, 64], (2, 1, 1)), "has another convention: unit (uv"),
        (lambda forward: forward[::-1], "has another convention: axis order"),
        (lambda forward: 2 * forward, "leads back from where motion leads in 0% of the moving pixels"),
    ],
)
@pytest.mark.parametrize("without", [(), ("depth", "instance")])
def test_forward_vectors_that_do_not_lead_back_fail(
    tmp_path: Path, change: Callable[[Pixels], Pixels], told: str, without: tuple[str, ...]
) -> None:
    frames = []
    for right in FRAMES:
        frame = right | {"forward_motion": change(right["forward_motion"]).astype(np.float32)}
        frames.append({name: values for name, values in frame.items() if name not in without})
    report = check(Clip(write_clip(tmp_path / "clip", frames)))
    assert report.verdict == "implausible"
    assert f"forward_motion: {told}" in report.reason


@pytest.mark.parametrize("name", ["motion", "forward_motion"])
def test_which_of_two_signs_of_y_is_right_is_unknown_where_everything_moves_sideways(tmp_path: Path, name: str) -> None:
    """Albedo that changes sideways alone is found with both signs, so neither channel is surely at fault."""
    velocity = np.float32([1.6, 0.6]).reshape(2, 1, 1) * np.ones((1, 64, 96), np.float32)
    frames = []
    for i in range(4):
        stripes = np.tile(smooth_texture(np.arange(96) - 1.6 * i, np.zeros(96), 4.0)[:, None], (1, 64, 1))
        shown = {"color": stripes, "albedo": stripes, "motion": -velocity, "forward_motion": velocity}
        frames.append(shown | {name: shown[name] * np.reshape(np.float32([1, -1]), (2, 1, 1))})
    report = check(Clip(write_clip(tmp_path / "clip", frames)))
    assert report.verdict == "undecidable"
    assert [(f.channel, f.doubt) for f in report.findings if "motion" in f.channel] == [("forward_motion", True)]
    assert "sign of y" in report.reason
    assert report.reason.endswith("; or motion is wrong")


def test_nothing_is_said_of_forward_vectors_that_are_right(tmp_path: Path) -> None:
    """A camera turns and travels, a ball moves by itself: parts are hidden, and vectors differ from pixel to pixel."""
    frames = [room_frame(i) for i in range(4)]
    for i, frame in enumerate(frames):
        ball = frame["instance"] == 2
        after = np.where(ball, frame["position"] + np.reshape([0.7, 0, 0], (3, 1, 1)), frame["position"])
        y, x = np.mgrid[: ball.shape[1], : ball.shape[2]] + 0.5
        frame["forward_motion"] = (np.where(frame["depth"] > 0, seen(after, i + 1) - [x, y], 0)).astype(np.float32)
    for name, shown in (("moving", frames), ("still", [frame | {"motion": 0 * frame["motion"]} for frame in FRAMES])):
        report = check(Clip(write_clip(tmp_path / name, shown)))
        assert not [finding for finding in report.findings if finding.channel == "forward_motion"]


@pytest.mark.parametrize(("lost", "frames"), [(slice(0, 32), [0, 1, 2, 3]), (slice(None), [1])])
def test_some_forward_vectors_that_are_zero_are_noted(tmp_path: Path, lost: slice, frames: list[int]) -> None:
    """A third of the picture, or a frame."""
    shown = [frame | {"forward_motion": frame["forward_motion"].copy()} for frame in FRAMES]
    for i in frames:
        shown[i]["forward_motion"][:, :, lost] = 0
    report = check(Clip(write_clip(tmp_path / "clip", shown)))
    told = [finding for finding in report.findings if finding.channel == "forward_motion"]
    assert len(told) == 1
    assert told[0].found.startswith("0 where motion is not, in 3")
    assert not told[0].fault
    assert report.verdict == "plausible"


def test_wrong_forward_vectors_accuse_no_instances() -> None:
    """What was hidden follows from them, and so which ids are compared along motion."""
    changed = {"instance": (10.0, 900.0, 10.0, 1000)}
    for returns, told in (([], ["instance"]), ([Returns(1000, 1000, Counter())], ["forward_motion"])):
        found = list(PairTally(changes=[changed], returns=returns).judge())
        assert [finding.channel for finding in found] == told
