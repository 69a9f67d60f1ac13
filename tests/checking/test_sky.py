"""The sky's vectors against the camera's turn."""

import numpy as np
import pytest
import torch

from nte.checking.sky import judge_sky, sky_motion
from nte.frames.frame import Frame

SIZE = 40, 64
HALF = 0.5  # tangent of half the camera's angle in y
PROJECTION = np.array(
    [[0.5 / HALF * SIZE[0] / SIZE[1], 0, 0.5, 0], [0, -0.5 / HALF, 0.5, 0], [0, 0, 1.001, -0.1], [0, 0, 1, 0]]
)


def turned(angle: float) -> np.ndarray:
    """A camera at a place of its own that looks along +z, turned about y."""
    view = np.eye(4)
    view[0, 0] = view[2, 2] = np.cos(angle)
    view[0, 2], view[2, 0] = np.sin(angle), -np.sin(angle)
    view[:3, 3] = [3 * angle, 1, -2]
    return view


def frame(angle: float, motion: float, sky_rows: int = 12) -> Frame:
    """Sky above a wall; the sky's vectors are `motion` px long in x."""
    depth, vectors = np.full((1, 1, *SIZE), 5.0, np.float32), np.zeros((1, 2, *SIZE), np.float32)
    depth[..., :sky_rows, :] = 0
    vectors[:, 0, :sky_rows] = motion
    cameras = {"view": turned(angle)[None], "projection": PROJECTION[None]}
    return Frame({"depth": depth, "motion": vectors}, 1, **cameras).torch()


def test_a_turn_by_an_angle_moves_the_sky_by_its_tangent() -> None:
    """By f·tan in the middle, with f = height / (2 · HALF), and x px beside it by 1 + x²/f² times that."""
    angle, focal, median = 0.05, SIZE[0] / (2 * HALF), SIZE[1] / 4
    found = sky_motion(frame(0.0, 0.0), frame(angle, 0.0))
    assert found is not None
    assert found.given == 0
    assert found.true == pytest.approx(focal * np.tan(angle) * (1 + (median / focal) ** 2), rel=0.02)
    (finding,) = judge_sky([found])
    assert not finding.fault
    assert finding.found.startswith("about 0 px long in the sky, which the turning camera moves by 2.")


def test_the_sign_counts() -> None:
    true = sky_motion(frame(0.0, 0.0), frame(0.05, 0.0))
    assert true is not None
    given = [sky_motion(frame(0.0, 0.0), frame(0.05, side * true.true)) for side in (1, -1)]
    told = [bool(list(judge_sky([motion]))) for motion in given if motion is not None]
    assert sorted(told) == [False, True]  # one of the two sides is right


def test_a_camera_that_only_travels_does_not_move_the_sky() -> None:
    before, now = frame(0.0, 0.0), frame(0.0, 0.0)
    view = now.view.clone()
    view[:, :3, 3] += torch.tensor([0.5, 0.1, -0.3])
    found = sky_motion(before, Frame(now.channels, 1, view=view, projection=now.projection))
    assert found == pytest.approx((0, 0, 0), abs=1e-6)
    assert not list(judge_sky([found]))


def test_nothing_is_said_without_cameras_or_sky() -> None:
    assert sky_motion(frame(0.0, 0.0), frame(0.05, 0.0, sky_rows=1)) is None
    bare = Frame(frame(0.05, 0.0).channels, 1)
    assert sky_motion(frame(0.0, 0.0), bare) is None
    assert not list(judge_sky([]))
