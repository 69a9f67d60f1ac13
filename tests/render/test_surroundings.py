"""What Mitsuba makes of an environment and of glass."""

import numpy as np
import pytest

from nte.render.engine.mesh_stage import MeshStage
from nte.render.scenes import kit, shapes
from nte.render.world.scene import Camera, Material, Scene
from nte.render.world.transforms import look_at, still, translation
from tests.render.shots import geometry_at, radiance_at, surface_at


def staged(environment: object, target: tuple[float, float, float], material: Material | None = None) -> MeshStage:
    """A ball 5 units towards −x, seen or not from the origin."""
    ball = material or Material(np.full((1, 1, 3), 0.5, np.float32))
    obj = kit.SceneObject(shapes.sphere(), ball, still(translation((-5, 0, 0))))
    return MeshStage(Scene((obj,), Camera(still(look_at((0, 0, 0), target)), 30), environment), 9, 9, 4)


@pytest.mark.parametrize("sun", [(1, 0.5, 0.2), (0.3, 0.6, -1), (-0.2, 0.4, 1), (0.9, -0.4, -0.9)])
def test_the_sun_is_seen_where_it_was_put(sun: tuple[float, float, float]):
    seen = surface_at(staged(kit.sky(np.random.default_rng(0), sun), sun), 0)["emission"].mean(0)
    assert seen[4, 4] == seen.max() > 100
    assert seen[4, 4] > 3 * seen[4, 0] > 0


def test_a_uniform_environment_lights_from_everywhere():
    """A furnace: outside, radiance 0.8 from all sides; a grey ball reflects half of it, and half of that again."""
    stage = staged((0.8, 0.8, 0.8), (-1, 0, 0))
    np.testing.assert_allclose(radiance_at(stage, 0, 64, 0)[:, 4, 4], 0.4, rtol=0.02)
    away = staged((0.8, 0.8, 0.8), (1, 0, 0))
    np.testing.assert_allclose(radiance_at(away, 0, 4, 0), 0.8, rtol=1e-4)
    assert (geometry_at(away, 0)["instance"] == 0).all()


def test_glass_shows_its_tint_and_roughness_and_lets_light_through():
    glass = Material(np.array([[[0.9, 1.0, 0.8]]], np.float32), "glass", 0.1)
    stage = staged((0.8, 0.8, 0.8), (-1, 0, 0), glass)
    shown = surface_at(stage, 0)
    np.testing.assert_allclose(shown["albedo"][:, 4, 4], [0.9, 1.0, 0.8], atol=1e-3)
    np.testing.assert_allclose(shown["roughness"][0, 4, 4], 0.1, atol=1e-3)
    assert radiance_at(stage, 0, 64, 0)[1, 4, 4] > 0.6
