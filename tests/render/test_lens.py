"""A thin lens: what is in focus stays, what is not spreads over the circle that optics says, in every mean channel."""

import dataclasses

import numpy as np
import pytest

from nte.render.engine.mesh_stage import MeshStage
from nte.render.scenes import shapes
from nte.render.scenes.families import FAMILIES
from nte.render.world.scene import Camera, Material, Scene, SceneObject
from nte.render.world.seeds import derive_generator
from nte.render.world.transforms import look_at, still
from tests.render.shots import geometry_at, guides_at, radiance_at, references_at
from tests.render.test_components import direct_light, recombined, staged, table

SIZE, FOV, APERTURE, FOCUS = 64, 40.0, 0.2, 4.0
FOCAL = SIZE / 2 / np.tan(np.radians(FOV / 2))  # pixels


def lamp(depth: float, aperture: float = APERTURE) -> MeshStage:
    """A white light, a tenth of the depth wide, in the middle of the image at this depth."""
    half = 0.05 * depth
    mesh = shapes.rectangle((half, -half, depth), (-2 * half, 0, 0), (0, 2 * half, 0))
    light = SceneObject(mesh, Material(np.ones((1, 1, 3), np.float32)), still(), (1.0, 1.0, 1.0))
    camera = Camera(still(look_at((0, 0, 0), (0, 0, 1))), FOV, aperture, FOCUS)
    return MeshStage(Scene((light,), camera), SIZE, SIZE, 2)


def test_what_is_in_focus_stays_sharp():
    sharp, through = guides_at(lamp(FOCUS, 0.0), 0), guides_at(lamp(FOCUS), 0)
    for name in ("albedo", "emission"):
        np.testing.assert_allclose(through[name], sharp[name], atol=0.13)  # 16 against 64 samples at its edge
        assert (np.abs(through[name] - sharp[name]) > 1e-6).mean() < 0.02


@pytest.mark.parametrize("depth", [2.0, 10.0])
def test_what_is_not_spreads_over_the_circle_of_confusion(depth: float):
    blurred = guides_at(lamp(depth), 0)["emission"][0]
    radius = APERTURE * FOCAL * abs(1 / depth - 1 / FOCUS)
    assert radius > 2
    edge, lit = 0.05 * FOCAL, np.nonzero(blurred[SIZE // 2] > 0)[0]
    assert (lit[-1] - lit[0] + 1) / 2 == pytest.approx(edge + radius, abs=1)
    assert blurred.sum() == pytest.approx((2 * edge) ** 2, rel=0.02)


@pytest.mark.parametrize("depth", [2.0, 10.0])
def test_the_guides_see_what_the_colour_sees(depth: float):
    stage = lamp(depth)
    np.testing.assert_allclose(guides_at(stage, 0)["emission"], radiance_at(stage, 0, 1024, 1), atol=0.12)


def test_geometry_is_that_of_the_pinhole():
    through, pinhole = (geometry_at(lamp(10.0, aperture), 0) for aperture in (APERTURE, 0.0))
    for name in through:
        np.testing.assert_allclose(through[name], pinhole[name], atol=1e-4)


def test_components_recombine_through_a_lens():
    scene = table()
    stage = staged(dataclasses.replace(scene, camera=dataclasses.replace(scene.camera, aperture=0.4, focus=2.5)))
    channels = guides_at(stage, 0) | references_at(stage, 0, 1024, (11, 12))
    channels["direct"] = direct_light(stage, 24)
    truth = radiance_at(stage, 0, 1024, 1)
    whole = recombined(channels, "reference_")
    assert whole.mean() == pytest.approx(truth.mean(), rel=0.01)
    assert np.abs(whole - truth).mean() < 0.06 * truth.mean()
    pinhole = radiance_at(staged(scene), 0, 1024, 1)
    assert np.abs(pinhole - truth).mean() > 0.12 * truth.mean()  # so the lens matters


def test_spheres_focus_on_the_middle_of_their_ring():
    scene = FAMILIES["spheres"](derive_generator("lens"))
    assert scene.camera.aperture > 0
    assert 4 < scene.camera.focus < 7
    assert FAMILIES["spheres"](derive_generator("lens"), given={"aperture": 0}).camera.aperture == 0
