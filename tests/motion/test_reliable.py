"""Shadow and reflection vectors as pure functions, on scenes whose answer is found in another way."""

import math

import pytest
import torch
from torch import Tensor

import nte.motion
from nte.motion.camera import move, points_from_depth, project
from nte.motion.reliable import mirror_image, reflection_covariance, reflection_motion, shadow_motion, shadow_point
from nte.motion.warp import pixel_centres

HEIGHT, WIDTH = 18, 30
PROJECTION = torch.tensor(
    [[1.1, 0, 0.5, 0], [0, -1.1 * WIDTH / HEIGHT, 0.5, 0], [0, 0, 1, -0.1], [0, 0, 1, 0]]
).double()


def turned(axis: tuple[float, float, float], angle: float, *offset: float) -> Tensor:
    """4×4: turns about an axis by Rodrigues' formula, then moves."""
    x, y, z = torch.nn.functional.normalize(torch.tensor(axis, dtype=torch.float64), dim=0).tolist()
    cross = torch.tensor([[0, -z, y], [z, 0, -x], [-y, x, 0]], dtype=torch.float64)
    matrix = torch.eye(4, dtype=torch.float64)
    matrix[:3, :3] += math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross
    matrix[:3, 3] = torch.tensor(offset or (0.0, 0, 0))
    return matrix


# Two cameras, world → view, that differ in everything, and how each has moved since.
NOW = torch.stack([turned((1, 0.1, 0), 0.5, 0, -0.5, 7), turned((1, -0.5, 0.3), 0.8, 0.4, 0.3, 9)])
BEFORE = torch.stack([turned((0, 1, 0), 0.03, 0.1, 0, 0), turned((1, 0, 1), -0.05, 0, 0.2, -0.3)]) @ NOW
PROJECTIONS = torch.stack([PROJECTION, PROJECTION * torch.tensor([[0.7], [0.7], [1], [1]])])
PROJECTIONS[1, 0, 2] = PROJECTIONS[1, 1, 2] = 0.5
TILT = turned((1, 0, 0.4), 0.35, 0, -0.6, 0)  # the receiver: y = 0, slanted
STEPS = {  # T⁻¹ of each, from the current frame to the previous one
    "light": turned((0, 0, 1), 0.0, 0.4, -0.2, 0.1),
    "blocker": turned((0.3, 1, 0), 0.1, -0.2, 0.05, 0.1),
    "receiver": turned((0, 0.2, 1), -0.08, 0.05, 0.1, 0),
    "camera": None,
}
LIGHT = torch.tensor([1.0, 6.0, -2.0, 1]).double()


def on_plane(plane: Tensor, view: Tensor, projection: Tensor) -> Tensor:
    """Points (N, 3, H, W) of y = 0 in the frame `plane` that the pixels' centres see, found by its equation."""
    depth = torch.ones(len(view), 1, HEIGHT, WIDTH, dtype=torch.float64)
    near, far = points_from_depth(depth, view, projection), points_from_depth(2 * depth, view, projection)
    normal, origin = plane[:3, 1], plane[:3, 3]
    offset = lambda points: torch.einsum("i,nihw->nhw", normal, points - origin[:, None, None])[:, None]  # noqa: E731
    return near + (far - near) * offset(near) / (offset(near) - offset(far))


def everywhere(vector: Tensor, like: Tensor) -> Tensor:
    return vector[:3, None, None].expand_as(like).clone()


def by(matrix: Tensor | None, points: Tensor) -> Tensor:
    """Points after a motion, by the module for people with their own engine."""
    if matrix is None:
        return points
    instance = torch.zeros(len(points), 1, HEIGHT, WIDTH)
    return move(points, instance, matrix[None])


@pytest.mark.parametrize("moving", [*STEPS, "all", "nothing"])
def test_shadow_of_a_point_on_a_slanted_plane(moving: str):
    """The twin moves into the previous receiver's own frame, where the plane is y = 0 and a shadow is a proportion."""
    step = {name: matrix if moving in (name, "all") else None for name, matrix in STEPS.items()}
    view_before = BEFORE if moving in ("camera", "all") else NOW
    here = on_plane(TILT, NOW, PROJECTIONS)
    light = everywhere(LIGHT, here)
    blocker = here + 0.3 * (light - here)
    plane = TILT if step["receiver"] is None else step["receiver"] @ TILT
    light, blocker = by(step["light"], light), by(step["blocker"], blocker)
    found = shadow_motion(
        light, blocker, by(step["receiver"], here), everywhere(3 * plane[:, 1], here), view_before, PROJECTIONS
    )
    l, b = (by(torch.linalg.inv(plane), points) for points in (light, blocker))  # noqa: E741
    shadow = torch.stack([(l[:, i] * b[:, 1] - b[:, i] * l[:, 1]) / (b[:, 1] - l[:, 1]) for i in (0, 2)], 1)
    shadow = by(plane, torch.stack([shadow[:, 0], torch.zeros_like(shadow[:, 0]), shadow[:, 1]], 1))
    expected = project(shadow, view_before, PROJECTIONS) - pixel_centres(shadow)
    assert found.shape == (2, 2, HEIGHT, WIDTH)
    known = torch.isfinite(expected)
    assert known.float().mean() > 0.9
    torch.testing.assert_close(found[known], expected[known], atol=1e-8, rtol=1e-8)
    largest = found.nan_to_num().abs().amax((1, 2, 3))
    assert (largest > 0.3).all() if moving != "nothing" else (largest < 1e-9).all()


def test_only_planes_beyond_the_blocker_are_in_its_shadow():
    """The plane behind the light, between light and blocker, touching the blocker, beyond it, and parallel."""
    light, blocker, normal = (torch.tensor(v, dtype=torch.float64) for v in ((0.0, 4, 0), (0.5, 2, 0), (0.0, 1, 0)))
    heights = torch.tensor([5.0, 3.0, 2.0, 1.0]).double()
    point = torch.zeros(1, 3, 1, 5, dtype=torch.float64)
    point[0, 1, 0, :4] = heights
    point[0, 0] = 7  # a plane is the same wherever its point is
    normals = everywhere(normal, point)
    normals[..., 4] = torch.tensor([4.0, 1.0, 0.0]).view(1, 3, 1)  # across to the line
    x, y = shadow_point(everywhere(light, point), everywhere(blocker, point), point, normals)[0, :2, 0]
    assert torch.isnan(x).tolist() == [True, True, False, False, True]
    torch.testing.assert_close(torch.stack([x, y])[:, 2:4], torch.tensor([[0.5, 0.75], [2.0, 1.0]]).double())


def test_contact_counts_for_a_light_as_far_as_the_sun():
    """In float32, with a blocker that lies on the floor, and one on the other side of it."""
    direction = torch.tensor([0.3, 0.9, 0.1])
    point, normal = torch.zeros(1, 3, 1, 2), torch.tensor([0.0, 1, 0]).view(1, 3, 1, 1).expand(1, 3, 1, 2)
    blocker = torch.tensor([[2.0, 2.0], [1e-6, -0.5], [1.0, 1.0]]).view(1, 3, 1, 2)
    found = shadow_point(
        (blocker[..., :1] + 1e5 * direction.view(1, 3, 1, 1)).expand(1, 3, 1, 2), blocker, point, normal
    )
    torch.testing.assert_close(found[..., 0], blocker[..., 0], atol=1e-3, rtol=0)
    assert torch.isnan(found[..., 1]).all()


@pytest.mark.parametrize("moving", ["target", "mirror", "camera", "all", "nothing"])
def test_reflection_in_a_slanted_mirror(moving: str):
    """The twin turns the previous mirror's frame upside down: y → −y."""
    here = on_plane(TILT, NOW, PROJECTIONS)
    eye = torch.linalg.inv(NOW)[:, :3, 3]
    # The reflected point h of each pixel, 3 units behind the mirror: the ray itself, turned over.
    flip = TILT @ torch.diag(torch.tensor([1.0, -1, 1, 1]).double()) @ torch.linalg.inv(TILT)
    ray = torch.nn.functional.normalize(here - eye[:, :, None, None], dim=1)
    target = by(flip, here + 3 * ray)
    mirror = STEPS["receiver"] if moving in ("mirror", "all") else torch.eye(4).double()
    then = by(STEPS["blocker"], target) if moving in ("target", "all") else target
    view_before = BEFORE if moving in ("camera", "all") else NOW
    plane = mirror @ TILT
    before = torch.linalg.inv(view_before)[:, :3, 3]
    image = mirror_image(then, by(mirror, here), everywhere(plane[:, 1], here), before)
    found = reflection_motion(image, view_before, PROJECTIONS)
    twin = by(plane @ torch.diag(torch.tensor([1.0, -1, 1, 1]).double()) @ torch.linalg.inv(plane), then)
    expected = project(twin, view_before, PROJECTIONS) - pixel_centres(twin)
    known = torch.isfinite(found)  # all but what the moving mirror no longer shows
    assert known.float().mean() > 0.95
    torch.testing.assert_close(found[known], expected[known], atol=1e-8, rtol=1e-8)
    largest = found.nan_to_num().abs().amax((1, 2, 3))
    assert (largest > 0.3).all() if moving != "nothing" else (largest < 1e-8).all()
    side = torch.einsum("ni,i->n", before - plane[:3, 3], plane[:3, 1]).sign().view(2, 1, 1, 1)
    other_side = by(mirror, here) - 2 * side * everywhere(plane[:, 1], here)
    assert torch.isnan(mirror_image(other_side, by(mirror, here), everywhere(plane[:, 1], here), before)).all()


def test_a_curved_mirror_shows_nearer_and_a_flat_one_the_same_with_curvature_zero():
    here = on_plane(TILT, NOW, PROJECTIONS)
    eye, normal = torch.linalg.inv(NOW)[:, :3, 3], everywhere(TILT[:, 1], here)
    side = torch.einsum("ni,i->n", eye - TILT[:3, 3], TILT[:3, 1]).sign().view(2, 1, 1, 1)
    target = here + 2 * side * normal + 0.3
    plain = mirror_image(target, here, normal, eye)
    flat = torch.zeros(2, 3, 3, HEIGHT, WIDTH).double()
    torch.testing.assert_close(mirror_image(target, here, normal, eye, flat), plain)
    one = normal[0, :, 0, 0]
    bulging = (0.2 * (torch.eye(3) - one[:, None] * one)).view(1, 3, 3, 1, 1).expand_as(flat)
    bent = flat.clone()
    bent[..., ::2] = bulging[..., ::2]  # only every other column
    image = mirror_image(target, here, normal, eye, bent)
    torch.testing.assert_close(image[..., 1::2], plain[..., 1::2])
    assert ((image - plain)[..., ::2].abs().amax(1) > 1e-3).all()


def test_covariance_is_that_of_microfacets_drawn_at_random():
    """A slow twin: which of many points of a slanted plane turn the target into the camera, for a pixel of each."""
    plane, roughness = TILT, 0.18
    here = on_plane(plane, NOW, PROJECTIONS)
    normal = everywhere(plane[:, 1], here)
    eye = torch.linalg.inv(NOW)[:, :3, 3]
    ray = torch.nn.functional.normalize(here - eye[:, :, None, None], dim=1)
    image = here + 2.5 * ray
    alpha = torch.full((2, 1, HEIGHT, WIDTH), roughness).double()
    found = reflection_covariance(image, here, normal, alpha, NOW, PROJECTIONS)
    generator = torch.Generator().manual_seed(0)
    for n, y, x in ((0, 12, 20), (1, 9, 6)):
        offset = 1.5 * (2 * torch.rand(400_000, 2, dtype=torch.float64, generator=generator) - 1)
        points = here[n, :, y, x] + offset @ plane[:3, [0, 2]].T
        flip = image[n, :, y, x] - 2 * ((image - here)[n, :, y, x] @ plane[:3, 1]) * plane[:3, 1]
        half = sum(torch.nn.functional.normalize(end - points, dim=1) for end in (eye[n], flip))
        local = half @ plane[:3, :3]
        weight = torch.exp(-(local[:, 0] ** 2 + local[:, 2] ** 2) / local[:, 1] ** 2 / roughness**4)
        clip = torch.cat([points, torch.ones(len(points), 1).double()], 1) @ (PROJECTIONS[n] @ NOW[n]).T
        position = clip[:, :2] / clip[:, 3:] * torch.tensor([WIDTH, HEIGHT])
        expected = torch.cov(position.T, aweights=weight)
        torch.testing.assert_close(
            found[n, :, y, x], torch.stack([expected[0, 0], expected[0, 1], expected[1, 1]]), rtol=0.1, atol=0.02
        )


def test_they_are_exported_by_the_package():
    assert nte.motion.shadow_motion is shadow_motion
    assert {"mirror_image", "reflection_motion", "reflection_covariance", "shadow_point"} <= set(nte.motion.__all__)
    with pytest.raises(AttributeError, match=r"nte\.motion"):
        nte.motion.nothing  # noqa: B018
