"""Meshes, textures and rooms, without rendering."""

import numpy as np
import pytest

from nte.render.passes.radiance import launches
from nte.render.scenes import patterns, shapes
from nte.render.scenes.families import FAMILIES
from nte.render.world.scene import Mesh
from nte.render.world.seeds import derive_generator

RNG = np.random.default_rng
SOLIDS = {
    "sphere": shapes.sphere, "cylinder": shapes.cylinder, "gem": shapes.gem,
    "box": lambda: shapes.box(RNG(0)), "vase": lambda: shapes.vase(RNG(1)), "torus": lambda: shapes.torus(RNG(2)),
    "knot": lambda: shapes.knot(RNG(3)), "boulder": lambda: shapes.boulder(RNG(4)),
}  # fmt: skip


@pytest.mark.parametrize("name", SOLIDS)
def test_solids_face_outwards(name: str):
    mesh: Mesh = SOLIDS[name]()
    a, b, c = mesh.positions[mesh.faces].transpose(1, 0, 2).astype(float)
    volume = np.einsum("fi,fi->", a, np.cross(b, c)) / 6  # positive where faces turn outwards
    assert volume > 0.1
    np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1, atol=1e-5)
    face = np.cross(b - a, c - a)
    large = np.linalg.norm(face, axis=1) > 1e-6  # triangles at a pole have no area
    agree = np.einsum("fi,fi->f", face, mesh.normals[mesh.faces].mean(1))
    assert (agree[large] > 0).mean() > 0.99
    assert np.abs(mesh.positions).max() < 1.6


def test_sphere_normals_are_exact():
    mesh = shapes.sphere()
    np.testing.assert_allclose(mesh.normals, mesh.positions, atol=2e-3)


def test_rectangle_faces_right_cross_up():
    mesh = shapes.rectangle((1, 0, 0), (2, 0, 0), (0, 3, 0), texture_size=2)
    np.testing.assert_allclose(mesh.normals, np.tile([0, 0, 1], (4, 1)), atol=1e-6)
    np.testing.assert_allclose(mesh.uv.max(0), [1, 1.5])


@pytest.mark.parametrize("pattern", patterns.PATTERNS)
@pytest.mark.parametrize("seed", range(3))
def test_textures_are_periodic_and_soft(pattern: patterns.Pattern, seed: int):
    weights = pattern(RNG(seed))
    np.testing.assert_allclose(weights.sum(-1), 1, atol=1e-9)
    assert weights.min() >= 0
    step = np.abs(np.diff(weights, axis=0, append=weights[:1])).max()
    across = np.abs(np.diff(weights, axis=1, append=weights[:, :1])).max()
    # No edge is harder than a rise over two texels; only whole bricks may differ by more, behind soft joints.
    assert max(step, across) < (1.01 if pattern is patterns.bricks else 0.7)


@pytest.mark.parametrize("seed", range(10))
def test_rooms_are_lit_and_alike_in_number(seed: int):
    room = FAMILIES["rooms"](derive_generator("test", seed))
    assert len(room.objects) == 15
    assert 1 <= sum(obj.radiance is not None for obj in room.objects) <= 3
    surfaces = {obj.material.surface for obj in room.objects}
    assert surfaces == {"diffuse", "glossy", "metal"}
    for obj in room.objects:
        assert 0 <= obj.material.color.min() <= obj.material.color.max() <= 1


@pytest.mark.parametrize("seed", range(10))
def test_things_stay_in_the_room_and_out_of_the_cameras_way(seed: int):
    room = FAMILIES["rooms"](derive_generator("test", seed))
    walls = np.concatenate([obj.mesh.positions for obj in room.objects[:6]])
    low, high = walls.min(0) - 0.35, walls.max(0) + 0.35  # a knot may touch a wall
    for time in np.linspace(-1, 24, 6):
        eye = room.camera.track(time)[:3, 3]
        assert (walls.min(0) < eye).all()
        assert (eye < walls.max(0)).all()
        for obj in room.objects[6:]:
            positions, _ = obj.at(time)
            assert (positions > low).all()
            assert (positions < high).all()
            if obj.radiance is None:
                assert np.linalg.norm(positions - eye, axis=1).min() > 0.5


def test_the_same_seed_gives_the_same_room():
    first, second = (FAMILIES["rooms"](derive_generator("test", 3)) for _ in range(2))
    for a, b in zip(first.objects, second.objects, strict=True):
        np.testing.assert_array_equal(a.at(2.5)[0], b.at(2.5)[0])
        np.testing.assert_array_equal(a.material.color, b.material.color)
    np.testing.assert_array_equal(first.camera.track(2.5), second.camera.track(2.5))


@pytest.mark.parametrize("spp", [1, 2, 3, 4, 32, 64, 100, 128, 1000])
def test_launches_are_powers_of_four_that_fit(spp: int):
    counts = list(launches(spp, pixels=1 << 20))
    assert sum(counts) == spp
    assert all(count in (1, 4, 16, 64) for count in counts)
