import numpy as np
import numpy.typing as npt
import pytest

from nte.importing.sky import motion_at_infinity, pixel_centres, recover_camera, with_sky_motion
from tests.importing.producers import SIZE, rotation

HIT = np.ones(SIZE, bool)
HIT[:10] = False


def camera(angle: float, position: tuple[float, float, float]) -> npt.NDArray[np.float64]:
    """World to pixels, at a focal length of 70 px."""
    intrinsic = np.array([[70, 0, SIZE[1] / 2], [0, 70, SIZE[0] / 2], [0, 0, 1.0]])
    basis = rotation(angle)
    return np.asarray(intrinsic @ np.concatenate([basis, -basis @ np.reshape(position, (3, 1))], 1))


def seen_by(matrix: npt.NDArray[np.float64], depth: npt.NDArray[np.float64]) -> npt.NDArray[np.float32]:
    """World points (3, H, W) that the camera sees at the pixel centres, at a depth (H, W)."""
    homogeneous = np.stack([*pixel_centres(SIZE), np.ones(SIZE)]) * depth
    points = np.linalg.solve(matrix[:, :3], homogeneous.reshape(3, -1) - matrix[:, 3:])
    return np.asarray(points.reshape(3, *SIZE), np.float32)


def unknown_sky() -> npt.NDArray[np.float32]:
    return np.where(HIT, np.float32(0), np.float32(np.nan)) * np.ones((2, 1, 1), np.float32)


RELIEF = np.random.default_rng(1).uniform(3, 9, SIZE)
FIRST, SECOND = camera(0.3, (100, 2, -4)), camera(0.35, (100.5, 2, -4))


def test_the_camera_is_recovered_from_what_it_sees() -> None:
    found = recover_camera(seen_by(FIRST, RELIEF), HIT)
    assert found is not None
    np.testing.assert_allclose(found / found[2, 3], FIRST / FIRST[2, 3], atol=1e-4, rtol=1e-3)


def test_the_sky_moves_as_the_camera_turns() -> None:
    motion = motion_at_infinity(SECOND, FIRST, SIZE)
    x, y, w = np.tensordot(FIRST[:, :3], seen_by(SECOND, np.full(SIZE, 1e6)), 1) + FIRST[:, 3].reshape(3, 1, 1)
    np.testing.assert_allclose(motion, np.stack([x, y]) / w - pixel_centres(SIZE), atol=1e-3)
    assert np.abs(motion[0]).mean() > 3  # 0.05 rad at 70 px
    frames = [
        {"position": seen_by(c, RELIEF) * HIT, "depth": (RELIEF * HIT)[None].astype("f")}
        | {name: unknown_sky() for name in ("motion", "forward_motion")}
        for c in (FIRST, SECOND)
    ]
    before, after = with_sky_motion(frames)
    np.testing.assert_allclose(after["motion"][:, ~HIT], motion[:, ~HIT], atol=2e-3)
    forward = motion_at_infinity(FIRST, SECOND, SIZE)
    np.testing.assert_allclose(before["forward_motion"][:, ~HIT], forward[:, ~HIT], atol=2e-3)
    for frame, name in ((before, "motion"), (after, "forward_motion"), (before, "forward_motion")):
        assert not frame[name][:, HIT].any()
    assert np.isnan(before["motion"][:, ~HIT]).all()  # nothing comes before
    assert np.isnan(after["forward_motion"][:, ~HIT]).all()


@pytest.mark.parametrize("case", ["plane", "orthographic", "few", "elsewhere"])
def test_no_camera_is_made_up(case: str) -> None:
    position, hit = seen_by(FIRST, RELIEF), HIT
    if case == "plane":
        position = seen_by(FIRST, np.full(SIZE, 5.0))
    elif case == "orthographic":
        position = np.stack([*pixel_centres(SIZE), RELIEF]).astype(np.float32)
    elif case == "few":
        hit = np.zeros(SIZE, bool)
        hit[:5, :5] = True
    else:
        position = np.random.default_rng(0).normal(size=(3, *SIZE)).astype(np.float32)
    assert recover_camera(position, hit) is None


def test_what_the_camera_turns_away_from_is_outside() -> None:
    motion = motion_at_infinity(camera(0.0, (0, 0, 0)), camera(np.pi, (0, 0, 0)), SIZE)
    assert (motion == -2 * SIZE[1]).all()


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_position_that_is_no_number_does_not_hide_the_camera(bad: float) -> None:
    points = seen_by(FIRST, RELIEF)
    points[1, 20, 30] = bad
    found = recover_camera(points, HIT)
    assert found is not None
    np.testing.assert_allclose(found / found[2, 3], FIRST / FIRST[2, 3], atol=1e-4, rtol=1e-3)
