"""Cameras whose image motion is known by hand."""

import math

import pytest
import torch
from torch import Tensor

from nte.motion.camera import motion_of, move, points_from_depth, project
from nte.motion.warp import pixel_centres

SIZE = (24, 32)


def perspective(focal: float = 1.0, near: float = 0.1, far: float = 100.0, axis: float = 1.0) -> Tensor:
    """A pinhole that looks along axis·z; u = ½ + focal·x/z, v = ½ − focal·y/z · (width/height)."""
    a, b = far / (far - near), -near * far / (far - near)
    aspect = SIZE[1] / SIZE[0]
    return torch.tensor(
        [[focal, 0, 0.5 * axis, 0], [0, -focal * aspect, 0.5 * axis, 0], [0, 0, a * axis, b], [0, 0, axis, 0]]
    )[None]


def translation(x: float, y: float, z: float) -> Tensor:
    matrix = torch.eye(4)
    matrix[:3, 3] = torch.tensor([x, y, z])
    return matrix[None]


def wall(z: float = 4.0) -> Tensor:
    return points_from_depth(torch.full((1, 1, *SIZE), z), torch.eye(4)[None], perspective())


def test_points_from_depth_lie_at_their_depth_and_project_back() -> None:
    for axis in (1.0, -1.0):
        view, projection = translation(0.3, -1.0, 0.5), perspective(axis=axis)
        depth = 1 + 5 * torch.rand(1, 1, *SIZE)
        points = points_from_depth(depth, view, projection)
        in_view = points[:, 2] + 0.5
        torch.testing.assert_close(axis * in_view, depth[:, 0], rtol=1e-4, atol=1e-4)
        centres = pixel_centres(depth)
        torch.testing.assert_close(project(points, view, projection), centres, rtol=0, atol=2e-3)


def test_a_camera_moving_sideways_shifts_a_wall_by_focal_over_depth() -> None:
    # The camera was 0.25 to the left: its image of the wall lay 0.25·focal/z·width = 2 px further right.
    motion = motion_of(wall(4.0), translation(0.25, 0, 0), perspective())
    expected = torch.tensor([2.0, 0.0]).view(1, 2, 1, 1).expand_as(motion)
    torch.testing.assert_close(motion, expected, rtol=0, atol=2e-3)


def test_vectors_in_double_precision_do_not_depend_on_where_the_world_has_its_origin() -> None:
    away = torch.tensor([1e6, -7e5, 5e5], dtype=torch.float64)
    view, projection = torch.eye(4, dtype=torch.float64)[None].clone(), perspective().double()
    view[0, :3, 3] = -away
    then = view.clone()
    then[0, 0, 3] += 0.25
    motion = motion_of(points_from_depth(torch.full((1, 1, *SIZE), 4.0).double(), view, projection), then, projection)
    expected = torch.tensor([2.0, 0.0], dtype=torch.float64).view(1, 2, 1, 1).expand_as(motion)
    torch.testing.assert_close(motion, expected, rtol=0, atol=1e-4)


def test_zooming_scales_about_the_image_centre() -> None:
    motion = motion_of(wall(), torch.eye(4)[None], perspective(focal=0.8))
    centre = torch.tensor([SIZE[1] / 2, SIZE[0] / 2]).view(1, 2, 1, 1)
    expected = (pixel_centres(motion) - centre) * (0.8 - 1)
    torch.testing.assert_close(motion, expected, rtol=0, atol=2e-3)


def test_a_rolling_camera_rotates_about_the_image_centre() -> None:
    angle = math.radians(7)
    roll = torch.eye(4)[None].clone()
    roll[0, :2, :2] = torch.tensor([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    motion = motion_of(wall(), roll, perspective())
    from_centre = pixel_centres(motion) - torch.tensor([SIZE[1] / 2, SIZE[0] / 2]).view(1, 2, 1, 1)
    x, y = from_centre[:, 0], from_centre[:, 1]
    # y counts downwards, so a counter-clockwise roll of the world is clockwise in (x, y).
    turned = torch.stack([math.cos(angle) * x + math.sin(angle) * y, -math.sin(angle) * x + math.cos(angle) * y], 1)
    torch.testing.assert_close(motion, turned - from_centre, rtol=0, atol=2e-3)


def test_sky_follows_the_rotation_and_ignores_the_translation() -> None:
    ray = points_from_depth(torch.zeros(1, 1, *SIZE), torch.eye(4)[None], perspective())
    sky = torch.zeros(1, 1, *SIZE, dtype=torch.bool)
    still = motion_of(ray, translation(5, -3, 2), perspective(), hit=sky)
    torch.testing.assert_close(still, torch.zeros_like(still), rtol=0, atol=2e-3)
    yaw = torch.eye(4)[None].clone()
    angle = math.radians(3)
    yaw[0, 0, 0] = yaw[0, 2, 2] = math.cos(angle)
    yaw[0, 0, 2], yaw[0, 2, 0] = math.sin(angle), -math.sin(angle)
    moved = motion_of(ray, yaw, perspective(), hit=sky)
    middle = moved[0, 0, SIZE[0] // 2, SIZE[1] // 2].item()
    assert middle == pytest.approx(math.tan(angle) * SIZE[1], rel=0.05)


def test_objects_carry_their_own_motion() -> None:
    points = wall(4.0)
    instance = torch.zeros(1, 1, *SIZE)
    instance[..., 16:] = 1
    transforms = torch.cat([torch.eye(4)[None], translation(-0.5, 0, 0)])
    motion = motion_of(move(points, instance, transforms), torch.eye(4)[None], perspective())
    torch.testing.assert_close(motion[..., :16], torch.zeros(1, 2, SIZE[0], 16), rtol=0, atol=2e-3)
    torch.testing.assert_close(motion[:, 0, :, 16:], torch.full((1, SIZE[0], 16), -4.0), rtol=0, atol=2e-3)


def test_behind_the_camera_is_nan() -> None:
    points = torch.tensor([0.0, 0.0, -1.0]).view(1, 3, 1, 1)
    assert project(points, torch.eye(4)[None], perspective()).isnan().all()
