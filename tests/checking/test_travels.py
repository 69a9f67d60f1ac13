"""Normals, positions and ids that do not move with what shows them are in doubt, without reference and cameras."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from nte.checking import CheckReport, check
from nte.checking.travels import TRAVELS, Changes, judge_changes
from nte.frames.clip import Clip
from tests.checking.test_late import SHOTS
from tests.synthetic import Pixels, write_clip

GIVEN = ("color", "albedo", "depth", "motion", *TRAVELS)
ORDERS: dict[str, Callable[[int], int]] = {
    "frozen": lambda i: 3,
    "reversed": lambda i: 6 - i,
    "shuffled": lambda i: (4 * i) % 7,
}


def of(folder: Path, name: str = "", order: Callable[[int], int] = lambda i: i) -> CheckReport:
    frames = []
    for i in range(7):
        frame = {n: SHOTS[i][n] for n in GIVEN if n == name or n not in ("position", "instance")}
        frames.append(frame | ({name: SHOTS[order(i)][name]} if name else {}))
    return check(Clip(write_clip(folder / "clip", frames)))


def told(report: CheckReport) -> list[str]:
    return [f.channel for f in report.findings if " along motion, and by " in f.found]


@pytest.mark.parametrize("name", TRAVELS)
@pytest.mark.parametrize("order", ORDERS)
def test_what_does_not_move_with_its_surface_is_a_doubt(tmp_path: Path, name: str, order: str) -> None:
    report = of(tmp_path, name, ORDERS[order])
    assert name in told(report)
    assert report.verdict != "plausible"


@pytest.mark.parametrize("name", ["", *TRAVELS])
def test_nothing_is_said_of_what_does(tmp_path: Path, name: str) -> None:
    assert not told(of(tmp_path, name))


def test_nothing_is_said_of_noise(tmp_path: Path) -> None:
    """Of one sample through a lens: it changes as much along vectors as anywhere."""
    rng = np.random.default_rng(3)
    frames = [{n: SHOTS[i][n] for n in GIVEN} for i in range(5)]
    for frame in frames:
        normal = frame["normal"] + (frame["depth"] > 0) * rng.normal(0, 0.4, frame["normal"].shape)
        frame["normal"] = (normal / np.linalg.norm(normal, axis=0).clip(min=1e-6)).astype(np.float32)
    assert not told(check(Clip(write_clip(tmp_path / "clip", frames))))


@pytest.mark.parametrize(("lost", "doubts"), [(1, 0), (2, 0), (3, 1), (5, 1)])
def test_most_pairs_of_frames_must_agree(lost: int, doubts: int) -> None:
    """A camera that flies out of a thing that turns loses much in a few frames, more than in all the others."""
    right: Changes = {"instance": (10.0, 5.0, 1.0, 1000)}
    wrong: Changes = {"instance": (100.0, 200.0, 1.0, 1000)}
    assert len(list(judge_changes([right] * (5 - lost) + [wrong] * lost))) == doubts


@pytest.mark.parametrize("unit", [1e-3, 1e3])
def test_units_of_positions_make_no_difference(tmp_path: Path, unit: float) -> None:
    def frames(order: Callable[[int], int]) -> list[dict[str, Pixels]]:
        given = ("color", "albedo", "instance", "motion")  # with depth, other checks would tell; ids are not judged
        return [{n: SHOTS[i][n] for n in given} | {"position": unit * SHOTS[order(i)]["position"]} for i in range(7)]

    right, frozen = (
        check(Clip(write_clip(tmp_path / name, frames(order))))
        for name, order in (("right", lambda i: i), ("frozen", ORDERS["frozen"]))
    )
    assert not told(right)
    assert told(frozen) == ["position"]
