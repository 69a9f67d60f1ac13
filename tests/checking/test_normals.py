"""Normals with strong bumps are compared with their surface where there is none."""

from collections.abc import Callable

import numpy as np
import pytest
import torch

from nte.checking.geometry import GeometryTally
from nte.frames.frame import Frame
from nte.importing.convert import unit
from tests.checking.room import camera, room_frame
from tests.synthetic import Pixels

Findings = list[tuple[bool, bool, str]]


def bumpy(index: int) -> dict[str, Pixels]:
    """The room; tiles whose normals lean by a third of a right angle or more cover a quarter of it."""
    frame = room_frame(index)
    y, x = np.mgrid[:64, :96]
    bumps = ((x // 6 + y // 6) % 4 == 0) * np.stack([np.sin(x), np.cos(1.3 * y), np.sin(x + 2 * y)])
    return frame | {"normal": unit(frame["normal"] + 1.2 * bumps * (frame["depth"] > 0))}


def told(turn: Pixels, index: int | None = None) -> list[tuple[str, bool]]:
    tally = GeometryTally()
    for i in range(3):
        frame = bumpy(i)
        frame["normal"] = np.einsum("ij,jhw->ihw", turn if index is None else turn @ camera(index)[1], frame["normal"])
        channels = {name: torch.tensor(np.float32(frame[name]))[None] for name in ("depth", "position", "normal")}
        tally.add(Frame(channels, i))
    return [(finding.found, finding.fault) for finding in tally.judge() if finding.channel == "normal"]


def test_nothing_is_said_of_bumps() -> None:
    assert told(np.eye(3, dtype=np.float32)) == []


def test_negated_normals_with_bumps_are_told() -> None:
    where = "point away from the camera in nearly all pixels, as position shows"
    assert told(-np.eye(3, dtype=np.float32)) == [(where, False)]


@pytest.mark.parametrize(("turn", "index"), [(np.diag([1, -1, 1]), None), (np.eye(3), 0)], ids=["flipped", "view"])
def test_normals_of_another_space_with_bumps_fail(turn: Pixels, index: int | None) -> None:
    found = "not perpendicular to the surfaces of position, but one rotation of all makes them so"
    assert told(turn, index) == [(found, True)]


def of_others(change: Callable[[Pixels], Pixels], names: tuple[str, ...] = ("depth", "position", "normal")) -> Findings:
    tally = GeometryTally()
    for i in range(3):
        frame = room_frame(i)
        frame["normal"] = unit(change(frame["normal"])) * (frame["depth"] > 0)
        tally.add(Frame({name: torch.tensor(np.float32(frame[name]))[None] for name in names}, i))
    return [(f.fault, f.doubt, f.found) for f in tally.judge() if f.channel == "normal"]


def before_a_horizon(index: int) -> dict[str, Pixels]:
    """A ground that ends in a horizon, and a ball on it: seen from afar all of it is flat."""
    height, width, focal = 64, 96, 80.0
    y, x = np.mgrid[:height, :width] + 0.5
    ray = np.stack([(x - width / 2) / focal, (height / 3 - y) / focal, -np.ones_like(x)])  # X right, Y up, Z backwards
    depth = np.where(ray[1] < 0, -1.5 / np.minimum(ray[1], -1e-6), 0)  # the ground is at Y = −1.5
    normal = np.stack([0 * x, 1 + 0 * x, 0 * x]) * (depth > 0)
    centre, radius = np.array([0.1 * index - 0.5, -0.5, -5.0])[:, None, None], 1.0
    along, squared = (ray * centre).sum(0), (ray * ray).sum(0)
    inside = along**2 - squared * ((centre * centre).sum(0) - radius**2)
    hit = (along - np.sqrt(np.maximum(inside, 0))) / squared
    ball = (inside > 0) & ((depth == 0) | (hit < depth))
    depth = np.where(ball, hit, depth)
    normal = np.where(ball, (ray * depth - centre) / radius, normal)
    return {"depth": depth[None], "position": ray * depth, "normal": normal}


@pytest.mark.parametrize("sign", [1, -1])
def test_what_stands_before_a_horizon_shows_the_side_of_the_ground(sign: int) -> None:
    tally = GeometryTally()
    for i in range(3):
        frame = before_a_horizon(i) | {"normal": sign * before_a_horizon(i)["normal"]}
        tally.add(Frame({name: torch.tensor(np.float32(values))[None] for name, values in frame.items()}, i))
    told = [finding.found for finding in tally.judge() if finding.channel == "normal"]
    assert told == ["point away from the camera in nearly all pixels, as position shows"] * (sign < 0)


OTHERS: dict[str, Callable[[Pixels], Pixels]] = {
    "noise": lambda normal: np.random.default_rng(0).normal(size=normal.shape),
    "waves": lambda normal: np.stack([np.sin(np.arange(96) / 5 + k) + 0 * normal[0] for k in range(3)]),
}


@pytest.mark.parametrize("name", OTHERS)
def test_normals_of_other_surfaces_are_a_doubt(name: str) -> None:
    ((fault, doubt, found),) = of_others(OTHERS[name])
    assert (fault, doubt) == (False, True)
    assert "° off from the surfaces of position on average" in found


def test_grass_tells_nothing_of_normals() -> None:
    """Surfaces that are finer than pixels: neighbouring positions span anything."""
    tally, rng = GeometryTally(), np.random.default_rng(1)
    for i in range(3):
        frame = room_frame(i)
        blades = 0.02 * rng.normal(size=frame["depth"].shape)
        frame["position"] = frame["position"] * (1 + blades)
        frame["depth"] = frame["depth"] * (1 + blades)
        names = "depth", "position", "normal"
        tally.add(Frame({name: torch.tensor(np.float32(frame[name]))[None] for name in names}, i))
    assert not [f for f in tally.judge() if f.channel == "normal" and (f.fault or f.doubt)]


@pytest.mark.parametrize("pitch", [0.05, -0.05, 0.0])
def test_a_level_camera_sees_the_side_of_the_floor(pitch: float) -> None:
    """Its normal says nothing of the view axis: in a camera that looks up a little, it points away along that."""
    y, x = np.mgrid[:64, :96] + 0.5
    ray = np.stack([(x - 48) / 80, (8 - y) / 80 + pitch, np.ones((64, 96)) - pitch * (8 - y) / 80])
    down = np.where(ray[1] < -0.05, -1.6 / ray[1].clip(max=-0.05), np.inf)
    floor = down < 20 / ray[2]
    along = np.where(floor, down, 20 / ray[2])  # before a wall
    depth = along * (ray[2] + pitch * ray[1])
    normal = np.stack([0 * x, 1.0 * floor, -1.0 * ~floor])
    for sign, told in ((1, []), (-1, ["point away from the camera in nearly all pixels, as position shows"])):
        channels = {"depth": depth[None], "position": along * ray, "normal": sign * normal}
        tally = GeometryTally()
        tally.add(Frame({name: torch.tensor(np.float32(values))[None] for name, values in channels.items()}))
        assert [finding.found for finding in tally.judge()] == told
