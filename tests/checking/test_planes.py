"""Depth of another kind bends where planes are straight: told without positions, vectors or cameras."""

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import torch

from nte.checking import check
from nte.checking.order import Order, depth_order, judge_order
from nte.checking.planes import PlaneTally
from nte.checking.values import Finding
from nte.frames.clip import Clip
from nte.frames.frame import Frame
from tests.checking.room import SIZE, room_frame
from tests.checking.test_geometry import cameras, checked
from tests.synthetic import Pixels, write_clip

Kind = Callable[[Pixels], Pixels]
WRONG: dict[str, tuple[Kind, str]] = {
    "inverse": (lambda z: 1 / z, "inverse, or a z-buffer"),
    "z-buffer": (lambda z: (100 - 100 / z) / 99, "inverse, or a z-buffer"),
    "from the far end": (lambda z: 100 - z, "counted from a plane at 100"),
    "from a plane behind": (lambda z: z + 5, "counted from a plane at 5"),
    "logarithm": (np.log, "a logarithm"),
}
RIGHT: dict[str, Kind] = {
    "right": lambda z: z,
    "in another unit": lambda z: 1e-4 * z,
    "half floats": lambda z: z.astype(np.float16),
    "16 bits": lambda z: np.round(z / 20 * 65535) / 65535 * 20,
    "8 bits": lambda z: np.round(z / 20 * 255) / 255 * 20,
}
NAMES = ("depth", "instance", "albedo", "motion")


def of_kind(frame: dict[str, Pixels], kind: Kind) -> dict[str, Pixels]:
    hit = frame["depth"] > 0
    return {"depth": np.where(hit, kind(np.where(hit, frame["depth"], 2)), 0).astype(np.float32)}


def tensors(frame: dict[str, Pixels], index: int = 0, **others: object) -> Frame:
    return Frame({name: torch.tensor(frame[name])[None] for name in NAMES if name in frame}, index, **others)  # type: ignore[arg-type]


def planes(kind: Kind, count: int = 2, without: tuple[str, ...] = ()) -> tuple[list[Finding], str]:
    tally = PlaneTally()
    for i in range(count):
        frame = room_frame(i)
        tally.add(tensors({name: v for name, v in (frame | of_kind(frame, kind)).items() if name not in without}))
    return list(tally.judge()), tally.not_judged(False)


@pytest.mark.parametrize("without", [(), ("instance",)])
@pytest.mark.parametrize("name", WRONG)
def test_another_kind_of_depth_is_named(name: str, without: tuple[str, ...]) -> None:
    kind, named = WRONG[name]
    (finding,), _ = planes(kind, without=without)
    assert f"only if it is {named}" in finding.found
    assert finding.fault or finding.doubt


@pytest.mark.parametrize("without", [(), ("instance",)])
@pytest.mark.parametrize("name", RIGHT)
def test_nothing_is_said_of_the_distance_along_the_view_axis(name: str, without: tuple[str, ...]) -> None:
    assert planes(RIGHT[name], without=without)[0] == []


@pytest.mark.parametrize("name", WRONG)
@pytest.mark.parametrize("known", [True, False])
def test_the_clip_is_never_plausible(tmp_path: Path, name: str, known: bool) -> None:
    """With cameras that have a centre even planes alone condemn it."""
    info = {"cameras": cameras(lambda v, p: (v, p))} if known else {}
    report = checked(tmp_path, lambda f, i: of_kind(f, WRONG[name][0]), ("position", "normal"), **info)
    planes_alone = known or "inverse" not in WRONG[name][1]  # else the camera may be an orthographic one
    told = [f.fault for f in report.findings if "planes are straight" in f.found]
    assert told == [planes_alone]
    assert report.verdict == ("implausible" if planes_alone or name == "inverse" else "undecidable")


@pytest.mark.parametrize("kind", [lambda z: 100 - z, lambda z: 1 / z])
@pytest.mark.parametrize("without", [(), ("instance",)])
def test_reversed_depth_of_any_unit_turns_around_what_hides_what(kind: Kind, without: tuple[str, ...]) -> None:
    """Frames have scales of their own here, and the offset makes all ratios of depths nearly 1."""
    frames = [room_frame(i) for i in range(4)]
    for turned in (False, True):
        given = []
        for i, frame in enumerate(frames):
            channels = frame | (of_kind(frame, kind) if turned else {})
            channels["depth"] = channels["depth"] * np.float32(1 + i % 2)
            given.append(tensors({name: v for name, v in channels.items() if name not in without}, i))
        orders = [depth_order(before, now) for before, now in pairwise(given)]
        assert [finding.fault for finding in judge_order(orders)] == [True] * turned
        assert sum(map(sum, orders)) > 100


def test_an_orthographic_camera_sees_planes_straight(tmp_path: Path) -> None:
    y, x = np.mgrid[: SIZE[0], : SIZE[1]] + 0.5
    slanted = {"depth": np.float32(5 + 0.0317 * x + 0.0531 * y)[None], "albedo": np.float32(0 * x + 0.5)[None]}
    tally = PlaneTally()
    for projection in (np.diag([0.1, -0.1, 0.01, 1.0]), None):
        given = {} if projection is None else {"projection": torch.tensor(projection)[None]}
        tally = PlaneTally()
        tally.add(tensors(slanted, **given))
        found = list(tally.judge())
        assert [finding.doubt for finding in found] == [True] * (projection is None)
    frame = {name: np.broadcast_to(v, (3, *SIZE)) if name == "albedo" else v for name, v in slanted.items()}
    report = check(Clip(write_clip(tmp_path / "clip", [frame | {"color": frame["albedo"]}] * 2)))
    assert report.verdict == "undecidable"


def test_what_has_no_planes_is_not_judged_and_says_so() -> None:
    def rough(z: Pixels) -> Pixels:
        return z * np.random.default_rng(0).uniform(0.9, 1.1, z.shape)

    found, why = planes(rough)
    assert found == []
    assert why.startswith("whether it is linear, or inverse: there is no position, and no slanted plane")
    assert planes(RIGHT["right"])[1] == ""


@pytest.mark.parametrize("size", [(1, 1), (2, 2), (3, 7), (5, 4)])
def test_tiny_pictures_tell_nothing(size: tuple[int, int]) -> None:
    rng = np.random.default_rng(0)
    frame = {name: rng.random((3 if name == "albedo" else 1, *size), np.float32) for name in NAMES[:3]}
    frame["motion"] = np.zeros((2, *size), np.float32)
    tally = PlaneTally()
    tally.add(tensors(frame))
    assert list(tally.judge()) == []
    assert depth_order(tensors(frame), tensors(frame, 1)) == Order(0, 0)


def test_instances_tell_what_hides_what_without_albedo(tmp_path: Path) -> None:
    frames = [{name: v for name, v in room_frame(i).items() if name not in ("albedo", "position")} for i in range(3)]
    given = [tensors(frame, i) for i, frame in enumerate(frames)]
    assert depth_order(given[0], given[1]).nearer > 20
    bare = [tensors({name: frame[name] for name in ("depth", "motion")}) for frame in frames]
    assert depth_order(bare[0], bare[1]) == Order(0, 0)
    assert check(Clip(write_clip(tmp_path / "clip", frames))).verdict != "implausible"
