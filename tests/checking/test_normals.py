"""Normals with strong bumps are compared with their surface where there is none."""

import numpy as np
import pytest
import torch

from nte.checking.geometry import GeometryTally
from nte.frames.frame import Frame
from nte.importing.convert import unit
from tests.checking.room import camera, room_frame
from tests.synthetic import Pixels


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


def test_negated_normals_with_bumps_are_noted() -> None:
    where = "point away from the camera in most pixels, as position shows"
    assert told(-np.eye(3, dtype=np.float32)) == [(where, False)]


@pytest.mark.parametrize(("turn", "index"), [(np.diag([1, -1, 1]), None), (np.eye(3), 0)], ids=["flipped", "view"])
def test_normals_of_another_space_with_bumps_fail(turn: Pixels, index: int | None) -> None:
    found = "not perpendicular to the surfaces of position, but one rotation of all makes them so"
    assert told(turn, index) == [(found, True)]
