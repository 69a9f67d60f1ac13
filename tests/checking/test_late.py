"""A channel that shows a neighbouring frame is told by name; what is right, blurred, still or cut never is."""

from pathlib import Path

import numpy as np
import pytest

from nte.checking import CheckReport, check
from nte.checking.late import SAME_FRAME, SHOWN
from nte.frames.clip import Clip
from tests.checking.room import room_frame
from tests.checking.test_flips import SUN
from tests.synthetic import Pixels, write_clip

Shot = dict[str, Pixels]
HERE = tuple(name for name in SHOWN if name in room_frame(0) and name != "instance")  # of two things: weak edges
OTHERS = (*HERE, "instance", "motion")


def shot(index: float) -> Shot:
    """The room in the sun, without noise."""
    frame = room_frame(index)
    sun = np.maximum(np.einsum("i,ihw->hw", SUN, frame["normal"]), 0) + 0.2
    light = (3 * frame["albedo"] * sun + 0.5 * (frame["depth"] == 0)).astype(np.float32)
    return frame | {"color": light, "reference": light}


SHOTS = [shot(i) for i in range(7)]


def noisy(light: Pixels, seed: int) -> Pixels:
    drawn = np.random.default_rng(seed).exponential(size=light.shape[1:])
    return (light * drawn).astype(np.float32)


def told(folder: Path, frames: list[Shot]) -> tuple[CheckReport, dict[str, str]]:
    report = check(Clip(write_clip(folder / "clip", frames)))
    return report, {f.channel: f.found for f in report.findings if f.expected == SAME_FRAME}


@pytest.mark.parametrize(("step", "when"), [(-1, "one frame earlier"), (1, "one frame later")])
@pytest.mark.parametrize("name", ["reference", *HERE])
def test_a_channel_of_a_neighbouring_frame_is_named(tmp_path: Path, name: str, step: int, when: str) -> None:
    frames = [SHOTS[i] | {"color": noisy(SHOTS[i]["color"], i), name: SHOTS[i + step][name]} for i in range(1, 6)]
    report, found = told(tmp_path, frames)
    light = "color" if name == "reference" else "reference"
    assert found == {name: f"shows what {light} shows {when}"}
    assert report.verdict == "implausible"


def test_all_channels_late_are_all_named(tmp_path: Path) -> None:
    """An engine that captures its surfaces one frame after the light; their vectors are late with them."""
    frames = [{name: SHOTS[i - 1 if name in OTHERS else i][name] for name in SHOTS[i]} for i in range(1, 6)]
    report, found = told(tmp_path, frames)
    assert found == dict.fromkeys(HERE, "shows what reference shows one frame earlier")
    assert report.verdict == "implausible"


@pytest.mark.parametrize("count", [3, 5])
@pytest.mark.parametrize("reference", [True, False])
def test_nothing_is_said_of_channels_of_one_frame(tmp_path: Path, reference: bool, count: int) -> None:
    frames = [SHOTS[i] | {"color": noisy(SHOTS[i]["color"], i)} for i in range(count)]
    left = [{n: v for n, v in frame.items() if reference or n != "reference"} for frame in frames]
    assert not told(tmp_path, left)[1]


def test_light_blurred_over_a_whole_frame_is_not_late(tmp_path: Path) -> None:
    """The shutter is open from one frame to the next; guides, and the reference of another render, have no blur."""
    for sides, blurred in (("a", ("color", "reference")), ("b", ("color",))):
        frames = []
        for i in range(5):
            over = np.mean([shot(i + (k + 0.5) / 8)["color"] for k in range(8)], 0)
            frames.append(SHOTS[i] | dict.fromkeys(blurred, over.astype(np.float32)))
        assert not told(tmp_path / sides, frames)[1]


def test_a_still_picture_is_never_late(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    still = SHOTS[0] | {"motion": 0 * SHOTS[0]["motion"]}
    frames = [still | {"color": noisy(still["color"], i)} for i in range(5)]
    assert not told(tmp_path / "a", frames)[1]
    for frame in frames:
        for name in HERE:
            frame[name] = (frame[name] + 0.1 * rng.normal(size=frame[name].shape)).astype(np.float32)
    assert not told(tmp_path / "b", frames)[1]


@pytest.mark.parametrize("backwards", [False, True])
@pytest.mark.parametrize("how", ["dark", "noise"])
def test_light_that_fades_over_a_still_picture_is_not_late(tmp_path: Path, how: str, backwards: bool) -> None:
    """A lamp is switched off, or noise grows: every frame of the light shows less of the channels than the one before.

    Backwards it shows more.
    """
    rng = np.random.default_rng(7)
    still = SHOTS[0] | {"motion": 0 * SHOTS[0]["motion"]}
    frames = []
    for fade in np.linspace(0, 0.95, 13)[:: -1 if backwards else 1]:
        light = still["reference"]
        if how == "dark":
            light = light * np.float32(fade < 0.5)
            frames.append(still | {"color": light, "reference": light})
        else:
            lit = rng.random((1, 64, 96)) > fade
            frames.append(still | {"color": (light * lit / (1 - fade)).astype(np.float32)})
    assert not told(tmp_path, frames)[1]


def test_light_that_repeats_is_not_late(tmp_path: Path) -> None:
    """The same few frames over and over: a neighbour is like the frame itself, and light has other edges too."""
    rng = np.random.default_rng(5)
    frames = [SHOTS[i % 2] | {"color": rng.exponential(size=(3, 64, 96)).astype(np.float32)} for i in range(6)]
    for frame in frames:
        del frame["reference"]
    assert not told(tmp_path, frames)[1]


@pytest.mark.parametrize("size", [(1, 1), (11, 200), (12, 12), (13, 31)])
def test_pictures_of_any_size_are_looked_at(tmp_path: Path, size: tuple[int, int]) -> None:
    rng = np.random.default_rng(6)
    names = ("color", "reference", "albedo")
    frames = [{name: rng.random((3, *size), np.float32) for name in names} for _ in range(4)]
    assert not told(tmp_path, frames)[1]
