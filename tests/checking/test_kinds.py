"""With positions, a depth that is another function of them is named, and nothing else is taken for it."""

from collections.abc import Callable

import numpy as np
import pytest
import torch

from nte.checking.geometry import GeometryTally
from nte.checking.kinds import KINDS
from nte.checking.values import Finding
from nte.frames.frame import Frame
from tests.checking.room import distances, room_frame
from tests.synthetic import Pixels

FRAMES = [room_frame(i) for i in range(4)]
FUNCTIONS: list[tuple[Callable[[Pixels], Pixels], str]] = [
    (lambda z: np.sqrt(z), "root"),
    (lambda z: np.log(z + 1), "logarithm"),
    (lambda z: np.log2(4 * z) / 9, "logarithm"),
    (lambda z: 1 / z, "buffer"),
    (lambda z: 1.001 - 0.1 / z, "buffer"),
    (lambda z: z / (z + 3), "buffer"),
]


def told(depths: list[Pixels]) -> list[Finding]:
    tally = GeometryTally()
    for i, (frame, depth) in enumerate(zip(FRAMES, depths, strict=True)):
        channels = {"position": frame["position"], "depth": np.float32(depth)}
        tally.add(Frame({name: torch.tensor(values)[None] for name, values in channels.items()}, i))
    return list(tally.judge())


@pytest.mark.parametrize(("function", "kind"), FUNCTIONS)
def test_a_function_of_depth_is_named(function: Callable[[Pixels], Pixels], kind: str) -> None:
    depths = []
    for frame in FRAMES:
        hit = frame["depth"] > 0
        depths.append(np.where(hit, function(np.where(hit, frame["depth"], 1)), 0))
    (finding,) = told(depths)
    assert finding.fault
    assert finding.found == f"is {KINDS[kind]}, as position shows"


def test_distances_are_named() -> None:
    (finding,) = told([distances(frame) for frame in FRAMES])
    assert finding.found == "is the distance from the camera, as position shows"


@pytest.mark.parametrize(
    ("units", "fault"), [((1, 1, 100, 100), True), ((3, 3, 3, 1), True), ((1, 1, 1, 2), False), ((5, 5, 5, 5), True)]
)
def test_of_two_units_the_factor_between_is_no_unit(units: tuple[int, ...], fault: bool) -> None:
    (finding,) = told([frame["depth"] * unit for frame, unit in zip(FRAMES, units, strict=True)])
    low, high = min(units), max(units)
    times = f"{low} to {high} times as long as position shows, as frames differ"
    assert finding.found == (f"is {times}" if low < high else f"is {low} times as long as position shows")
    assert finding.fault == fault
