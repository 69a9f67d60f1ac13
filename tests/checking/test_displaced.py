"""A channel of another place in the picture is told by name and place; right and late channels never are."""

from pathlib import Path

import numpy as np
import pytest

from nte.checking import CheckReport, check
from nte.checking.displaced import SAME_PLACE
from nte.frames.clip import Clip
from tests.checking.test_late import OTHERS, SHOTS, Shot, noisy
from tests.synthetic import smooth_texture, write_clip


def report_of(folder: Path, frames: list[Shot]) -> CheckReport:
    return check(Clip(write_clip(folder / "clip", frames)))


def told(report: CheckReport) -> dict[str, str]:
    return {f.channel: f.found for f in report.findings if f.expected == SAME_PLACE}


def displaced(frame: Shot, names: tuple[str, ...], right: int, down: int) -> Shot:
    """The frame with channels that show what lies so far right and below, as one that begins there."""
    return frame | {name: np.roll(frame[name], (-down, -right), (1, 2)) for name in names}


@pytest.mark.parametrize("names", [("reference",), ("albedo",), ("normal",), OTHERS])
def test_a_channel_of_another_place_is_named(tmp_path: Path, names: tuple[str, ...]) -> None:
    """Such as one whose data window was ignored, or that is of the other eye; nothing else is blamed."""
    frames = [SHOTS[i] | {"color": noisy(SHOTS[i]["color"], i)} for i in range(5)]
    report = report_of(tmp_path, [displaced(f, names, 8, -6) for f in frames])
    found = told(report)
    assert {*found} - {"depth", "instance"} == {*names} & {
        "reference",
        "albedo",
        "normal",
    }  # the others have weak edges here
    assert all(" about 8 px to the right and 6 px above" in what for what in found.values())
    assert report.verdict == "implausible"
    assert not [f for f in report.findings if "one frame" in f.found]


@pytest.mark.parametrize("with_reference", [True, False])
def test_nothing_is_said_of_channels_of_one_place(tmp_path: Path, with_reference: bool) -> None:
    frames = [SHOTS[i] | {"color": noisy(SHOTS[i]["color"], i)} for i in range(4)]
    if not with_reference:
        frames = [{n: v for n, v in f.items() if n != "reference"} for f in frames]
    assert not told(report_of(tmp_path, frames))


def test_what_a_pan_displaces_is_late(tmp_path: Path) -> None:
    frames = [{n: SHOTS[i - 1 if n in OTHERS else i][n] for n in SHOTS[i]} for i in range(1, 6)]
    assert not told(report_of(tmp_path, frames))


def test_shadows_of_what_floats_leave_depth_in_doubt(tmp_path: Path) -> None:
    """Discs above a ground in the sun, whose hard shadows all lie at the same place beside them: the clip is right."""
    rng = np.random.default_rng(4)
    y, x = np.mgrid[:96, :128] + 0.5
    discs = [(*rng.uniform((0, 0), (128, 96)), rng.uniform(3, 6)) for _ in range(25)]
    frames = []
    for i in range(4):
        disc, shadow = (
            np.any([np.hypot(x - (u + 2 * i) % 128 - right, y - v - down) < r for u, v, r in discs], 0)
            for right, down in ((0, 0), (9, 6))
        )
        albedo = np.where(disc, 0.3, smooth_texture(3 * x, 3 * y, 1.0)).astype(np.float32)
        light = (2 * albedo * np.where(shadow & ~disc, 0.1, 1)).astype(np.float32)
        depth = np.where(disc, 7, 10)[None].astype(np.float32)
        frames.append({"color": noisy(light, i), "reference": light, "albedo": albedo, "depth": depth})
    report = check(Clip(write_clip(tmp_path / "clip", frames)))
    assert report.verdict == "undecidable"
    assert [(f.channel, f.fault) for f in report.findings if f.expected == SAME_PLACE] == [("depth", False)]
    assert "or shadows lie there" in report.reason
