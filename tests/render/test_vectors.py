"""Shadow and reflection vectors where the answer is known in closed form."""

from collections.abc import Callable

import numpy as np
import pytest

from nte.frames.bad import count_bad
from nte.frames.frame import Frame
from nte.render.components.frame import noisy
from nte.render.components.reliable_motion import footprint
from nte.render.engine import plugins
from nte.render.engine.mesh_stage import MeshStage
from nte.render.scenes import shapes
from nte.render.scenes.families import FAMILIES
from nte.render.world.scene import Camera, Material, Scene, SceneObject
from nte.render.world.seeds import derive_generator
from nte.render.world.transforms import Track, look_at, moving, rotation, still, translation

SIZE, FOV = 48, 50.0
GREY = np.full((1, 1, 3), 0.6, np.float32)
UP = (0.0, 1.0, 0.0)


def drift(*speed: float) -> Callable[[tuple[float, float, float]], Track]:
    """place → a track through it at time 1, moving by `speed` per frame."""
    return lambda place: moving(lambda time: np.array(place) + np.array(speed) * (time - 1), UP, 0.0)


def turning(angle: float, axis=UP) -> Callable[[tuple[float, float, float]], Track]:
    return lambda place: lambda time: translation(place) @ rotation(axis, angle * (time - 1))


def carried(track: Track, points: np.ndarray) -> np.ndarray:
    """Points (3, H, W) of an object at time 1, where they were at time 0."""
    back = track(0) @ np.linalg.inv(track(1))
    return np.einsum("ij,jhw->ihw", back[:3, :3], points) + back[:3, 3][:, None, None]


def square(size: float) -> shapes.Mesh:
    """Centred, in the plane y = 0, facing up."""
    return shapes.rectangle((-size, 0, size), (2 * size, 0, 0), (0, 0, -2 * size))


def thing(mesh, place, motion, radiance=None, **material) -> SceneObject:
    return SceneObject(mesh, Material(GREY, **material), motion(place), radiance)


def vectors(scene: Scene) -> dict[str, np.ndarray]:
    made = MeshStage(scene, SIZE, SIZE, 3)
    return noisy(made, 1, [5])[1][0]


def pixels(camera: Camera, time: float, points: np.ndarray) -> np.ndarray:
    """(2, H, W) of world points (3, H, W)."""
    matrix = camera.projection(SIZE, SIZE) @ camera.view(time)
    clip = np.einsum("ij,jhw->ihw", matrix, np.concatenate([points, np.ones_like(points[:1])]))
    return clip[:2] / clip[3:] * SIZE


def on_plane(camera: Camera, time: float, position: np.ndarray, height: float) -> np.ndarray:
    """Points (3, H, W) of the plane y = height that are seen at pixel positions (2, H, W)."""
    to_world = np.linalg.inv(camera.view(time))
    scale = camera.projection(SIZE, SIZE)[0, 0]
    x, y = (position / SIZE - 0.5) / scale
    ray = np.einsum("ij,jhw->ihw", to_world[:3, :3], np.stack([x, y, np.ones_like(x)]))
    eye = to_world[:3, 3][:, None, None]
    return eye + ray * (height - eye[1]) / ray[1]


CENTRES = np.stack(np.meshgrid(np.arange(SIZE) + 0.5, np.arange(SIZE) + 0.5))
STILL, LAMP, PLATE = drift(0, 0, 0), np.array([0.5, 4.0, 0.2]), np.array([0.1, 1.5, 0.0])


@pytest.mark.parametrize(
    ("lamp", "plate", "floor", "camera"),
    [
        (STILL, drift(0.1, 0.05, -0.06), STILL, (0, 0, 0)),
        (drift(-0.15, 0.1, 0.1), STILL, STILL, (0, 0, 0)),
        (STILL, STILL, drift(0.05, 0.07, 0.02), (0, 0, 0)),
        (drift(0.1, 0, 0), drift(0.1, 0.05, -0.06), drift(0, 0.05, 0), (0.05, -0.02, 0.03)),
        (STILL, turning(0.08), STILL, (0, 0, 0)),
        (STILL, STILL, turning(0.06, (1, 0, 0.3)), (0, 0, 0)),
        (drift(0.1, 0, 0), turning(-0.06), turning(0.03, (0.2, 0, 1)), (0, 0.03, 0)),
        (STILL, STILL, STILL, (0, 0, 0)),
    ],
    ids=["blocker", "light", "receiver", "everything", "turning blocker", "tilting receiver", "all turning", "nothing"],
)
def test_shadow_of_a_plate_on_a_floor(lamp, plate, floor, camera):
    """With a lamp that is almost a point, the shadow is the plate seen from the lamp, projected on the floor."""
    eye = moving(lambda time: np.array(camera) * (time - 1), UP, 0.0)
    seen_from = Camera(lambda time: eye(time) @ look_at((0, 5, -4), (0, 0, 0)), FOV)
    over = lambda place: lambda time: lamp(place)(time) @ rotation((1, 0, 0), np.pi)  # noqa: E731  it looks down
    scene = Scene(
        (
            thing(square(6), (0, 0, 0), floor),
            thing(square(0.8), tuple(PLATE), plate),
            thing(square(1e-3), tuple(LAMP), over, (3e6, 3e6, 3e6)),
        ),
        seen_from,
    )
    found = vectors(scene)
    shadowed = found["visibility"][0] == 0
    motion = found["shadow_motion"]
    assert shadowed.mean() > 0.02
    assert np.isfinite(motion[:, shadowed]).all()
    assert np.isnan(motion[:, ~shadowed]).all()

    here = on_plane(seen_from, 1, CENTRES, 0.0)
    # The blocker: where the line from the lamp to the pixel's point crosses the plate's plane.
    to_lamp = LAMP[:, None, None] - here
    blocker = here + to_lamp * PLATE[1] / to_lamp[1]
    blocker = carried(plate(tuple(PLATE)), blocker)
    source = lamp(tuple(LAMP))(0)[:3, 3][:, None, None]
    point, normal = floor((0, 0, 0))(0)[:3, 3], floor((0, 0, 0))(0)[:3, 1]
    line = blocker - source
    reach = (normal @ point - np.einsum("i,ihw->hw", normal, source)) / np.einsum("i,ihw->hw", normal, line)
    before = source + reach * line
    expected = pixels(seen_from, 0, before) - CENTRES
    # The vector starts at a random point of the pixel, half a pixel from the centre at most in x and in y. What turns
    # makes it differ within a pixel by some of its angle, so that this cannot be told from an error otherwise.
    within = sum(np.abs(np.gradient(expected, axis=axis)) for axis in (1, 2)) / 2
    error = (motion - expected)[:, shadowed]
    assert (np.abs(error) - within[:, shadowed]).max() < 0.02
    assert np.abs(error).max() < 0.1
    assert np.abs(error.mean(1)).max() < 0.01  # over all places in a pixel, that cancels
    moves = np.abs(expected[:, shadowed]).max()
    assert (moves > 0.5) == any(track is not STILL for track in (lamp, plate, floor))


def mirror_scene(ball, camera: Track, floor=STILL) -> Scene:
    return Scene(
        (
            thing(square(20), (0, 0, 0), floor, surface="metal", roughness=0.0),
            thing(square(3), (0, 1.5, 2.0), lambda place: lambda t: ball(place)(t) @ rotation((1, 0, 0), -np.pi / 2)),
            thing(
                square(1), (0, 9, 0), lambda place: still(translation(place) @ rotation((1, 0, 0), np.pi)), (9, 9, 9)
            ),
        ),
        Camera(camera, FOV),
    )


@pytest.mark.parametrize(
    ("wall", "camera", "floor"),
    [
        (drift(0.1, 0.05, -0.1), still(look_at((0, 3, -4), (0, 0, 0))), STILL),
        (
            STILL,
            lambda time: translation((0.1 * time, 0.05 * time, 0)) @ look_at((0, 3, -4), (0.1 * time, 0, 0)),
            STILL,
        ),
        (
            turning(0.05),
            lambda time: translation((0.05 * time, 0, 0)) @ look_at((0, 3, -4), (0, 0, 0)),
            drift(0, 0.06, 0),
        ),
    ],
    ids=["object", "camera", "all"],
)
def test_reflection_in_a_plane_mirror(wall, camera, floor, monkeypatch: pytest.MonkeyPatch):
    """The mirror image of a wall moves like a wall behind the mirror."""
    ours = plugins.bsdf
    monkeypatch.setattr(plugins, "bsdf", lambda m: {"type": "conductor"} if m.surface == "metal" else ours(m))
    scene = mirror_scene(wall, camera, floor)
    found = vectors(scene)
    motion, covariance = found["reflection_motion"], found["reflection_covariance"]
    reflects = np.isfinite(motion).all(0)
    assert reflects.mean() > 0.4

    # Follow each pixel's centre by hand: mirror the eye, meet the wall, carry it back, mirror it, project.
    here = on_plane(scene.camera, 1, CENTRES, 0.0)
    eye = np.linalg.inv(scene.camera.view(1))[:3, 3]
    below = (eye * (1, -1, 1))[:, None, None]
    now, then = (wall((0, 1.5, 2.0))(t) for t in (1, 0))
    normal = now[:3, 2]  # the wall's mesh looks along y, turned to −z
    along = here - below
    t = (normal @ (now[:3, 3] - below[:, 0, 0])) / np.einsum("i,ihw->hw", normal, along)
    hit = below + t * along
    local = np.einsum("ij,jhw->ihw", np.linalg.inv(now)[:3, :3], hit - now[:3, 3][:, None, None])
    on_wall = reflects & (np.abs(local[:2]) < 2.9).all(0)
    assert on_wall.mean() > 0.1
    before = np.einsum("ij,jhw->ihw", then[:3, :3], local) + then[:3, 3][:, None, None]
    height = floor((0, 0, 0))(0)[1, 3]
    before[1] = 2 * height - before[1]
    expected = pixels(scene.camera, 0, before) - CENTRES
    slope = np.abs(np.gradient(expected, axis=(1, 2))).sum((0, 1))
    inner = on_wall & (slope < 0.15)
    assert inner.sum() > 0.8 * on_wall.sum()
    assert np.abs(motion - expected).max(0)[inner].max() < 0.1
    assert np.abs(expected[:, inner]).max() > 0.5
    assert np.isfinite(covariance[:, reflects]).all()


@pytest.mark.parametrize(
    ("eye", "gaze", "target"),
    [
        ((0, 3, -4), (0, 0, 0), (0.7, 1.2, 1.5)),
        ((0, 1.6, -1.6), (0, 0.8, 2), (0.5, 2.0, 6.0)),
        ((0, 4, 0), (0, 0, 0.1), (0.2, 2, 0)),
    ],
    ids=["oblique", "grazing, far", "from above"],
)
def test_covariance_is_that_of_the_points_that_reflect_the_same(eye, gaze, target):
    """A slow twin: of many points of the floor, how well does each reflect the target into the camera?"""
    roughness, target, eye = 0.15, np.array(target), np.array(eye, float)
    floor = thing(square(20), (0, 0, 0), STILL, surface="metal", roughness=roughness)
    lamp = thing(square(1), (0, 9, 0), STILL, (9, 9, 9))
    made = MeshStage(Scene((floor, lamp), Camera(still(look_at(eye, gaze)), FOV)), SIZE, SIZE, 3)
    image = target * (1, -1, 1)
    with made.at(0) as moment:
        found = footprint(moment, np.tile(image, (SIZE * SIZE, 1)))[0]

    middle = eye + (image - eye) * eye[1] / (eye[1] - image[1])
    offset = np.random.default_rng(0).uniform(-2, 2, (1_000_000, 2))
    points = middle + np.stack([offset[:, 0], np.zeros(len(offset)), offset[:, 1]], 1)
    microfacet = sum((end - points) / np.linalg.norm(end - points, axis=1, keepdims=True) for end in (eye, target))
    slope = microfacet[:, ::2] / microfacet[:, 1:2]
    beckmann = np.exp(-(slope**2).sum(1) / roughness**4)
    position = pixels(made.camera, 0, points.T[:, :, None])[:, :, 0]
    seen = beckmann > 1e-9  # these lie before the camera
    expected = np.cov(position[:, seen], aweights=beckmann[seen])
    np.testing.assert_allclose(found, expected[[0, 0, 1], [0, 1, 1]], atol=0.05 * np.trace(expected))


def test_where_no_pixel_is_shadowed_and_none_reflects_there_are_no_vectors():
    down = still(translation((0, 4, 0)) @ rotation((1, 0, 0), np.pi))
    lamp = thing(square(0.5), (0, 4, 0), lambda _: down, (9, 9, 9))
    found = vectors(
        Scene((thing(square(6), (0, 0, 0), STILL), lamp), Camera(still(look_at((0, 3, -3), (0, 0, 0))), FOV))
    )
    assert found["color"].max() > 0
    for name in ("shadow_motion", "reflection_motion", "reflection_covariance"):
        assert np.isnan(found[name]).all(), name


def test_a_deep_room_has_finite_vectors_or_none():
    made = MeshStage(FAMILIES["rooms"](derive_generator("vectors")), SIZE, SIZE, 3)
    channels = noisy(made, 2, [1])[1][0]
    for name in ("shadow_motion", "reflection_motion"):
        known = np.isfinite(channels[name])
        assert (known[0] == known[1]).all()
        assert known.any()
    assert (np.isnan(channels["reflection_motion"][0]) == np.isnan(channels["reflection_covariance"][0])).all()
    assert (np.isfinite(channels["shadow_motion"][0]) <= (channels["visibility"][0] == 0)).all()
    xx, xy, yy = channels["reflection_covariance"]
    assert not (xx * yy - xy**2 < -1e-3 * (xx + yy) ** 2).any()


def test_lobes_that_no_filter_can_look_at_are_unknown():
    """Two lobes on a floor that is seen at grazing angles: the linear approximation of some has no bound."""
    scene = FAMILIES["limits"](derive_generator("test", "limits", 0), "test", {"case": "two_lobes"})
    stage = MeshStage(scene, SIZE, SIZE, 3)
    _, seeds = noisy(stage, 1, list(range(12)))
    lobes = np.stack([seed["reflection_covariance"] for seed in seeds])
    motion = np.stack([seed["reflection_motion"] for seed in seeds])
    assert np.nanmax(np.abs(lobes)) <= 64**2 * (SIZE**2 + SIZE**2)
    np.testing.assert_array_equal(np.isnan(lobes).any(1), np.isnan(motion).any(1))
    for seed in seeds:
        assert not count_bad(Frame({name: values[None] for name, values in seed.items()}))
