"""Furniture, limbs, lathes and water: faces and normals look outwards, and sizes are what they say."""

import numpy as np
import pytest

from nte.render.scenes import furniture, shapes, solids
from nte.render.scenes.families.outdoors import ocean
from nte.render.scenes.family import Dice
from nte.render.world.scene import Mesh
from nte.render.world.transforms import rotation, translation

RNG = np.random.default_rng
CLOSED = {
    "block": lambda: solids.block((1, 2, 3)),
    "cushion": lambda: solids.cushion((1, 0.5, 2), 0.2),
    "capsule": lambda: solids.capsule(1.0, 0.2),
    "chair": furniture.chair,
    "table": lambda: furniture.table(2, 1),
    "round table": lambda: furniture.round_table(0.5),
    "shelf": lambda: furniture.shelf(1, 2, 0.3, 5),
    "books": lambda: furniture.books(RNG(0), 1.0),
    "bed": furniture.bed,
    "stand": lambda: furniture.stand(1.2),
    "plate": furniture.plate,
    "glass": furniture.glass,
    "bottle": furniture.bottle,
    "apple": lambda: furniture.apple(RNG(1))[0],
    "stem": lambda: furniture.apple(RNG(1))[1],
    "placed": lambda: solids.placed(shapes.sphere(), rotation((1, 2, 3), 1.0) @ translation((4, 5, 6)), (2, 1, 0.5)),
}


def corners(mesh: Mesh) -> np.ndarray:
    return mesh.positions[mesh.faces].transpose(1, 0, 2).astype(float)


@pytest.mark.parametrize("name", CLOSED)
def test_faces_and_normals_look_outwards(name: str):
    mesh = CLOSED[name]()
    a, b, c = corners(mesh) - mesh.positions.mean(0)
    assert np.einsum("fi,fi->", a, np.cross(b, c)) > 0  # six times the volume
    assert np.isfinite(mesh.normals).all()
    np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1, atol=1e-4)
    face = np.cross(b - a, c - a)
    area = np.linalg.norm(face, axis=1)
    agree = np.einsum("fi,fi->f", face, mesh.normals[mesh.faces].mean(1)) > 0
    assert area[agree].sum() > 0.98 * area.sum()


def test_sizes():
    for mesh, size in ((solids.block((1, 2, 3)), (1, 2, 3)), (solids.cushion((1, 0.5, 2), 0.2), (1, 0.5, 2))):
        np.testing.assert_allclose(mesh.positions.max(0) - mesh.positions.min(0), size, atol=1e-5)
        assert mesh.positions[:, 1].min() == pytest.approx(0, abs=1e-6)
    limb = solids.capsule(1.0, 0.2).positions
    np.testing.assert_allclose([limb[:, 1].min(), limb[:, 1].max()], [-1.2, 0.2], atol=1e-3)


def test_a_lathe_passes_through_its_points():
    profile = np.array([(0, 0), (1, 0.5), (0.5, 1), (0, 2)])
    turned = solids.turned(profile, rows=200).positions
    line = np.stack([np.hypot(turned[:, 0], turned[:, 2]), turned[:, 1]], 1)
    for point in profile:
        assert np.linalg.norm(line - point, axis=1).min() < 0.02


def test_merged_keeps_every_part():
    parts = [solids.block((1, 1, 1)), shapes.sphere()]
    whole = solids.merged(parts)
    np.testing.assert_array_equal(whole.positions[whole.faces[-1]], parts[1].positions[parts[1].faces[-1]])
    assert len(whole.faces) == sum(len(part.faces) for part in parts)


def test_a_frame_leaves_its_opening():
    frame = solids.framed((0, 0, 0), (4, 0, 0), (0, 2, 0), (0.25, 0.75, 0.25, 0.5))
    a, b, c = corners(frame)
    assert np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2 == pytest.approx(8 - 2 * 0.5)
    np.testing.assert_allclose(frame.normals, np.tile([0, 0, 1], (len(frame.normals), 1)), atol=1e-6)


def test_normals_of_the_water_stand_on_it():
    trains = ocean._trains(Dice(RNG(0), "train"), 0.3)
    rest, step = RNG(1).uniform(-5, 5, (200, 3)) * (1, 0, 1), 1e-5
    _, normals = ocean._surface(trains, rest, 3.3)
    for way in ((step, 0, 0), (0, 0, step)):
        ahead, behind = (ocean._surface(trains, rest + sign * np.array(way), 3.3)[0] for sign in (1, -1))
        tangent = (ahead - behind) / (2 * step)
        np.testing.assert_allclose(np.einsum("ni,ni->n", tangent, normals), 0, atol=1e-6)
    assert (normals[:, 1] > 0).all()
