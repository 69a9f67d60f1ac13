"""Guides as other renderers give them: one sample of a pixel, and other conventions for the albedo of mirrors."""

from pathlib import Path

import numpy as np
import pytest

from nte.frames.clip import Clip
from nte.render.engine.mesh_stage import MeshStage
from nte.render.passes.gbuffer import surface
from nte.render.passes.rays import trace_surfaces
from nte.render.recipes.clips import render_recipe
from nte.render.world.scene import Material, SceneObject
from nte.render.world.transforms import rotation, still, translation
from tests.render.test_gbuffer import board, flat, staged

STRIPES = np.repeat(np.array([[[0.1, 0.2, 0.3]], [[0.9, 0.7, 0.5]]], np.float32), 4, 0)
SLANTED = still(translation((0, 0, 3)) @ rotation((0.2, 1.0, 0.3), 0.5))


@pytest.fixture(scope="module")
def stage() -> MeshStage:
    """A slanted board with fine stripes, in front of nothing."""
    return staged(board(0, 1, SLANTED, color=STRIPES.repeat(8, 1)))


def test_samples_of_their_own_average_to_those_that_pixels_share(stage: MeshStage):
    rng = np.random.default_rng(1)
    with stage.at(0) as moment:
        count = stage.width * stage.height
        own = surface(moment, rng.random((count, 400, 4)))
        shared = surface(moment, rng.random((4000, 4)))
    assert np.abs(own["albedo"] - shared["albedo"]).max() < 0.12  # 400 samples of a stripe: σ ≤ 0.02
    assert np.abs(own["albedo"] - shared["albedo"]).mean() < 0.006


def test_each_pixel_takes_its_own_place(stage: MeshStage):
    """All pixels but one look at their middle; that one, at a corner, sees what a shared place would show there."""
    middle, corner = np.full((stage.width * stage.height, 1, 4), 0.5), np.array([[0.02, 0.97, 0.5, 0.5]])
    chosen = 17 * stage.width + 23
    mixed = middle.copy()
    mixed[chosen] = corner
    with stage.at(0) as moment:
        found, centred, cornered = (trace_surfaces(moment, places).normal for places in (mixed, middle, corner))
        albedos = [trace_surfaces(moment, places).albedo for places in (mixed, middle, corner)]
    others = np.arange(len(middle)) != chosen
    np.testing.assert_array_equal(found[others], centred[others])
    np.testing.assert_array_equal(albedos[0][chosen], albedos[2][chosen])
    np.testing.assert_array_equal(albedos[0][others], albedos[1][others])
    assert (cornered[others] != centred[others]).any()


@pytest.mark.parametrize(("mirrors", "metal", "glass"), [("colour", 0.6, 0.8), ("black", 0.0, 0.0), ("white", 1, 1)])
def test_albedo_of_mirrors(mirrors, metal: float, glass: float):
    def at(x: float, surface: str, value: float) -> SceneObject:
        return board(
            0, 0.4, still(translation((x, 0, 3))), color=flat(value, value, value), surface=surface, roughness=0.3
        )

    stage = staged(at(1.0, "metal", 0.6), at(0.0, "glossy", 0.5), at(-1.0, "glass", 0.8))
    with stage.at(0) as moment:
        albedo = surface(moment, np.full((1, 4), 0.5), mirrors)["albedo"][0, stage.height // 2]
    middle, step = stage.width // 2, 11  # world +x is to the left
    assert albedo[middle - step] == pytest.approx(metal, abs=1e-3)
    assert albedo[middle] == pytest.approx(0.5, abs=1e-3)  # glossy keeps its colour: its base is diffuse
    assert albedo[middle + step] == pytest.approx(glass, abs=1e-3)


def test_textured_roughness_reaches_the_guide():
    rough = np.repeat(np.array([[[0.1]], [[0.6]]], np.float32), 4, 0)
    lying = still(translation((0, 0, 1.2)))
    found = surface_of_board(Material(flat(0.5, 0.5, 0.5), "glossy", rough.repeat(8, 1)), lying)["roughness"]
    assert found.min() == pytest.approx(0.1, abs=0.02)
    assert found.max() == pytest.approx(0.6, abs=0.02)


def surface_of_board(material: Material, track) -> dict[str, np.ndarray]:
    plain = board(0, 2, track)
    stage = staged(SceneObject(plain.mesh, material, track))
    with stage.at(0) as moment:
        return surface(moment)


RECIPE = """
name: styles
seed: 3
train:
  - {scene: jumble, clips: 1, frames: 2, width: 24, height: 16, reference_spp: 4, guides: GUIDES, mirrors: MIRRORS}
"""


@pytest.mark.slow
def test_clips_say_that_their_guides_alias(tmp_path: Path):
    """One random sample changes the guides alone, and the clip says that they are not clean."""
    clips = {}
    for guides in ("averaged", "centred", "random"):
        recipe = tmp_path / f"{guides}.yaml"
        recipe.write_text(RECIPE.replace("GUIDES", guides).replace("MIRRORS", "black"))
        render_recipe(recipe, tmp_path / guides, progress=False)
        clips[guides] = Clip(tmp_path / guides / "train/jumble_000")
    assert [clip.clean_guides for clip in clips.values()] == [True, False, False]
    albedo = {name: clip.frame(0)["albedo"] for name, clip in clips.items()}
    assert np.isfinite(albedo["random"]).all()
    assert (albedo["random"] != albedo["centred"]).any()
    for name in ("color", "depth", "motion"):
        np.testing.assert_array_equal(clips["random"].frame(1)[name], clips["averaged"].frame(1)[name])
