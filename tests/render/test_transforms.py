"""Transforms, tracks and the camera's matrices."""

import numpy as np
import pytest

from nte.render.world.scene import Camera
from nte.render.world.transforms import look_at, moving, rotation, still, transform_points, translation


def test_rotation_is_counter_clockwise_about_its_axis():
    turned = transform_points(rotation((0, 0, 2), np.pi / 2), np.array([[1.0, 0, 5]]))
    np.testing.assert_allclose(turned, [[0, 1, 5]], atol=1e-12)


def test_look_at_is_rigid_and_looks_along_z():
    matrix = look_at((1, 2, 3), (4, 0, 9))
    np.testing.assert_allclose(matrix[:3, :3] @ matrix[:3, :3].T, np.eye(3), atol=1e-12)
    assert np.linalg.det(matrix) == pytest.approx(1)
    forward = np.array([3, -2, 6]) / 7
    np.testing.assert_allclose(matrix[:3, 2], forward, atol=1e-12)
    np.testing.assert_allclose(matrix[:3, 3], (1, 2, 3))


def test_tracks_hold_at_any_time():
    track = moving(lambda time: np.array([time, 0, 0]), (0, 1, 0), 0.1)
    np.testing.assert_allclose(track(-1)[:3, 3], (-1, 0, 0))
    np.testing.assert_allclose(track(2.5), translation((2.5, 0, 0)) @ rotation((0, 1, 0), 0.25))
    assert still()(0.3) is still()(7.0) or np.array_equal(still()(0.3), np.eye(4))


def test_projection_has_x_right_and_y_down():
    camera = Camera(still(look_at((0, 0, 0), (0, 0, 1))), 90)
    points = np.array([[0, 0, 5, 1], [-5, 0, 5, 1], [0, 5, 5, 1], [-2.5, -2.5, 5, 1.0]])
    clip = points @ (camera.projection(200, 100) @ camera.view(0)).T
    pixels = clip[:, :2] / clip[:, 3:] * (200, 100)
    # Looking along +z with y up, world −x is to the right.
    np.testing.assert_allclose(pixels, [[100, 50], [200, 50], [100, -50], [150, 100]], atol=1e-9)
