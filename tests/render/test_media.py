"""Media: furnaces, transmittance in closed form, and what the channels without noise show of them."""

import dataclasses

import numpy as np
import pytest

from nte.render.engine.mesh_stage import MeshStage
from nte.render.engine.plugins import VEIL
from nte.render.scenes import shapes
from nte.render.scenes.families import FAMILIES
from nte.render.scenes.families.outdoors.cloud import _noise, _shift
from nte.render.scenes.family import Dice
from nte.render.scenes.solids import block
from nte.render.world.scene import Camera, Material, Medium, Scene, SceneObject
from nte.render.world.seeds import derive_generator
from nte.render.world.transforms import look_at, still, translation
from tests.render.shots import geometry_at, guides_at, radiance_at, surface_at

SIZE = 12
WHITE = np.ones((1, 1, 3), np.float32)


def half_filled(time: float) -> np.ndarray:
    """Dense above, thin below; the upper half thins out as time passes."""
    grid = np.full((2, 2, 3), 0.25, np.float32)
    grid[:, 1] = 1 / (1 + time)
    return grid


def box(medium: Medium, material: Material | None = None) -> SceneObject:
    """Two units high and wide, 1 deep, its middle 5 units before the camera."""
    mesh = block((2, 2, 1), (0, -1, 5))
    return SceneObject(mesh, material or Material(WHITE, "none"), still(), medium=medium)


def staged(*objects: SceneObject, environment=(1.0, 1.0, 1.0), depth: int = 400, fov: float = 16.0) -> MeshStage:
    camera = Camera(still(look_at((0, 0, 0), (0, 0, 1))), fov)
    return MeshStage(Scene(objects, camera, environment, depth), SIZE, SIZE, 4)


@pytest.mark.parametrize("medium", [Medium(3.0), Medium(6.0, anisotropy=0.9), Medium(5.0, density=half_filled)])
def test_a_medium_that_absorbs_nothing_cannot_be_seen_in_a_furnace(medium: Medium):
    image = radiance_at(staged(box(medium)), 0, 512, 1)
    assert image.mean() == pytest.approx(1, abs=8e-3)


def test_what_absorbs_everything_lets_through_what_beer_and_lambert_say():
    image = radiance_at(staged(box(Medium(0.8, (0.0, 0.0, 0.0)))), 0, 4096, 1)
    assert image[:, 4:8, 4:8].mean() == pytest.approx(np.exp(-0.8), rel=0.01)


def test_the_density_lies_where_it_was_put_at_its_time():
    medium = Medium(2.0, (0.0, 0.0, 0.0), density=half_filled)
    for time, upper in ((0.0, 1.0), (3.0, 0.25)):
        image = radiance_at(staged(box(medium), fov=20.0), time, 1024, 1)
        assert image[:, 1:3, 3:9].mean() == pytest.approx(np.exp(-2 * upper), rel=0.06)
        assert image[:, -3:-1, 3:9].mean() == pytest.approx(np.exp(-2 * 0.25), rel=0.06)


def test_the_channels_without_noise_look_past_what_cannot_be_seen():
    wall = SceneObject(
        shapes.rectangle((0.5, -3, 8), (-4, 0, 0), (0, 6, 0)), Material(WHITE * np.float32(0.4)), still()
    )
    with_medium = guides_at(staged(box(Medium(9.0)), wall, environment=(0.3, 0.3, 0.3)), 0)
    empty = dataclasses.replace(box(Medium(9.0)), track=still(translation((0, 50, 0))))
    without = guides_at(staged(empty, wall, environment=(0.3, 0.3, 0.3)), 0)
    assert set(np.unique(with_medium["instance"])) == {0, 2}
    for name in without:
        np.testing.assert_allclose(with_medium[name], without[name], atol=1e-5, err_msg=name)


def test_a_veil_is_a_surface_that_hardly_reflects():
    stage = staged(box(Medium(1e-6, (0.0, 0.0, 0.0)), Material(WHITE * np.float32(0.5), "veil")), depth=8)
    shown = surface_at(stage, 0)
    np.testing.assert_allclose(shown["albedo"][:, 6, 6], 0.5, atol=1e-5)
    assert (geometry_at(stage, 0)["depth"][0, 6, 6]) == pytest.approx(4.5, abs=1e-4)
    passed = (1 - VEIL) ** 2
    seen = radiance_at(stage, 0, 256, 1)[:, 4:8, 4:8].mean()
    assert passed < seen < passed + 2 * VEIL


@pytest.mark.parametrize("family", ["cloud", "subsurface"])
def test_light_is_finite_and_moves_while_the_guides_rest(family: str):
    stage = MeshStage(FAMILIES[family](derive_generator("media", family)), 48, 48, 4)
    first, second = (guides_at(stage, time) | {"color": radiance_at(stage, time, 64, 1)} for time in (2.0, 4.0))
    change = np.abs(first["color"] - second["color"]).mean() / first["color"].mean()
    assert np.isfinite(first["color"]).all()
    assert change > 0.1
    assert (first["motion"] == 0).all()
    np.testing.assert_array_equal(first["albedo"], second["albedo"])


def test_air_drifts_exactly_and_by_fractions_of_a_cell():
    waves = _noise(Dice(np.random.default_rng(0), "train"), 0.8)
    cell = 13.0 / 104
    np.testing.assert_allclose(
        np.fft.ifftn(waves * _shift(np.array([3 * cell, 0, 0]))).real,
        np.roll(np.fft.ifftn(waves).real, 3, axis=2),
        atol=1e-9,
    )
    half = _shift(np.array([0.5 * cell, 0, 0]))
    np.testing.assert_allclose(
        np.fft.ifftn(waves * half * half).real, np.roll(np.fft.ifftn(waves).real, 1, axis=2), atol=1e-9
    )
