"""The G-buffer against scenes whose answer is known."""

import dataclasses

import numpy as np
import pytest

from nte.render.engine.mesh_stage import MeshStage
from nte.render.scenes import shapes
from nte.render.world.scene import Camera, Material, Scene, SceneObject
from nte.render.world.transforms import look_at, moving, rotation, still, translation
from tests.render.shots import geometry_at, guides_at, radiance_at

WIDTH, HEIGHT, FOV = 40, 30, 60.0
FOCAL = WIDTH / 2 / np.tan(np.radians(FOV / 2))
SPEED = np.array([-0.3, 0.1, 0.2])  # world −x is to the right of a camera that looks along +z


def flat(red: float, green: float, blue: float) -> np.ndarray:
    return np.array([[[red, green, blue]]], np.float32)


def board(z: float, size: float, track=None, **material) -> SceneObject:
    """A square that faces the camera at z = 0."""
    mesh = shapes.rectangle((size, -size, 0), (-2 * size, 0, 0), (0, 2 * size, 0))
    colour = material.pop("color", flat(0.2, 0.4, 0.6))
    return SceneObject(mesh, Material(colour, **material), track or still(translation((0, 0, z))))


def staged(*objects: SceneObject, camera=None) -> MeshStage:
    track = camera or still(look_at((0, 0, 0), (0, 0, 1)))
    turned = still(translation((0, 0, -1)) @ rotation((0, 1, 0), np.pi))
    lamp = dataclasses.replace(board(0, 0.5, turned), radiance=(1.0, 1.0, 1.0))  # behind the camera
    return MeshStage(Scene((*objects, lamp), Camera(track, FOV)), WIDTH, HEIGHT, 4)


@pytest.fixture(scope="module")
def moving_board() -> dict[str, np.ndarray]:
    path = moving(lambda time: np.array([0, 0, 4]) + SPEED * time, (0, 1, 0), 0.0)
    return guides_at(staged(board(0, 1, path, surface="metal", roughness=0.3)), 0)


def test_depth_position_and_miss(moving_board):
    hit = moving_board["depth"][0] > 0
    assert 0.05 < hit.mean() < 0.5
    np.testing.assert_allclose(moving_board["depth"][0][hit], 4, rtol=1e-6)
    for name in ("depth", "position", "instance"):
        assert (moving_board[name][:, ~hit] == 0).all()
    assert set(np.unique(moving_board["instance"])) == {0, 1}
    y, x = np.nonzero(hit)
    expected = np.stack([-(x + 0.5 - WIDTH / 2), -(y + 0.5 - HEIGHT / 2)]) * 4 / FOCAL
    np.testing.assert_allclose(moving_board["position"][:2, hit], expected, atol=1e-5)


@pytest.mark.parametrize(("name", "sign"), [("motion", -1), ("forward_motion", 1)])
def test_object_motion(moving_board, name, sign):
    hit = moving_board["depth"][0] > 0
    then = moving_board["position"] + sign * SPEED[:, None, None]
    pixels = np.stack([WIDTH / 2 - FOCAL * then[0] / then[2], HEIGHT / 2 - FOCAL * then[1] / then[2]])
    y, x = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    np.testing.assert_allclose(moving_board[name][:, hit], (pixels - np.stack([x, y]))[:, hit], atol=1e-4)
    assert (moving_board[name][:, ~hit] == 0).all()  # sky behind a camera that rests


def test_surface_channels(moving_board):
    inside = moving_board["albedo"][2] > 0.599
    assert inside.any()
    np.testing.assert_allclose(moving_board["albedo"][:, inside].T, [[0.2, 0.4, 0.6]] * inside.sum(), atol=1e-5)
    np.testing.assert_allclose(moving_board["normal"][:, inside].T, [[0, 0, -1]] * inside.sum(), atol=1e-5)
    np.testing.assert_allclose(moving_board["roughness"][0, inside], 0.3, atol=1e-5)
    edge = (moving_board["albedo"][2] > 0) & ~inside
    assert edge.any()  # averaged over the pixel
    np.testing.assert_allclose(np.linalg.norm(moving_board["normal"][:, edge], axis=0), 1, atol=1e-5)


def test_sky_moves_with_the_cameras_rotation_only():
    def pan(time: float) -> np.ndarray:
        return translation((3 * time, 0, 0)) @ rotation((0, 1, 0), 0.02 * time)

    stage = staged(camera=pan)
    motion = geometry_at(stage, 0)["motion"]
    y, x = HEIGHT // 2, WIDTH // 2
    # The camera turns counter-clockwise seen from above, that is to its left: the sky moved to the right, and
    # was one frame earlier to the left.
    angle = np.arctan((x + 0.5 - WIDTH / 2) / FOCAL)
    assert motion[0, y, x] == pytest.approx(FOCAL * (np.tan(angle - 0.02) - np.tan(angle)), abs=1e-3)
    assert abs(motion[1, y, x]) < 0.05


def test_a_resting_scene_has_no_motion_at_all():
    stage = staged(board(3, 5), board(2.5, 0.4))
    channels = geometry_at(stage, 5)
    assert (channels["motion"] == 0).all()
    assert (channels["forward_motion"] == 0).all()
    assert set(np.unique(channels["instance"])) == {1, 2}


def test_a_light_has_albedo_and_emission():
    lamp = dataclasses.replace(board(3, 5, color=flat(0.8, 0.8, 0.8)), radiance=(7.0, 6.0, 5.0))
    stage = staged(lamp)
    channels = guides_at(stage, 0)
    np.testing.assert_allclose(channels["emission"][:, 15, 20], [7, 6, 5], rtol=1e-5)
    np.testing.assert_allclose(channels["albedo"][:, 15, 20], 0.8, rtol=1e-5)
    seen = radiance_at(stage, 0, 4, seed=1)[:, 15, 20]
    assert (seen >= 7 * 0.99 - np.array([0, 1, 2])).all()


def test_roughness_of_diffuse_is_one_and_normals_face_the_camera():
    tilted = still(translation((0, 0, 3)) @ rotation((0, 1, 0), np.pi + 0.4))  # seen from behind
    channels = guides_at(staged(board(0, 1, tilted)), 0)
    np.testing.assert_allclose(channels["roughness"], 1, atol=1e-6)
    normal = channels["normal"][:, HEIGHT // 2, WIDTH // 2]
    np.testing.assert_allclose(np.linalg.norm(normal), 1, atol=1e-5)
    assert normal[2] < 0


def test_radiance_repeats_and_differs_by_seed():
    stage = staged(board(3, 5))
    first, again, other = (radiance_at(stage, 0, 20, seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)
    assert first.mean() > 0
