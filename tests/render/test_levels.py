"""Somebody's own scene on two levels: what moves costs one rebuild a frame, and all vectors stay exact."""

from pathlib import Path

import numpy as np
import pytest

from nte.frames import Clip
from nte.render.components.frame import noisy
from nte.render.engine.plugins import make_mesh
from nte.render.engine.xml import loading
from nte.render.engine.xml.levels import Levels
from nte.render.engine.xml.stage import XmlStage
from nte.render.passes.gbuffer import geometry
from nte.render.recipes.clips import render_recipe
from nte.render.scenes import shapes
from nte.render.world.keyframes import read_animation
from nte.render.world.scene import Material, SceneObject
from nte.render.world.transforms import still
from tests.render.shots import geometry_at

HEIGHT, WIDTH = 40, 56
LIGHT, PLATE, EYE = np.array([0.5, 4.0, 0.2]), 1.5, (0.4, 6.0, -0.5)
STEP, FRAMES = np.array([0.4, 0.1, 0.3]), 10.0  # of the plate, in so many frames
_LYING = '<transform name="to_world"><rotate x="1" angle="-90"/><scale value="{}"/><translate y="{}"/></transform>'


def write(folder: Path, moving: bool = True) -> Path:
    """A plate above a floor, beside balls that stand still, below a point light: only the plate moves."""
    balls = "".join(
        f'<shape type="sphere"><point name="center" x="{x}" y="0.2" z="1.6"/><float name="radius" value="0.2"/></shape>'
        for x in np.linspace(-2, 2, 9)
    )
    (folder / "scene.xml").write_text(f"""<scene version="3.0.0">
      <sensor type="perspective"><float name="fov" value="45"/><transform name="to_world">
        <lookat origin="{EYE[0]}, {EYE[1]}, {EYE[2]}" target="0, 0, 0" up="0, 0, 1"/></transform></sensor>
      <shape type="rectangle" id="floor">{_LYING.format(6, 0)}</shape>{balls}
      <shape type="rectangle" id="plate">{_LYING.format(0.4, PLATE)}</shape>
      <emitter type="point" id="light"><point name="position" x="{LIGHT[0]}" y="{LIGHT[1]}" z="{LIGHT[2]}"/>
        <rgb name="intensity" value="9"/></emitter></scene>""")
    keys = (
        f"\nobjects: {{plate: [{{frame: 0}}, {{frame: {FRAMES:.0f}, translate: {STEP.tolist()}}}]}}" if moving else ""
    )
    (folder / "moves.yaml").write_text("xml: scene.xml" + keys)
    return folder / "moves.yaml"


def staged(folder: Path, moving: bool = True) -> XmlStage:
    return XmlStage(read_animation(write(folder, moving)), WIDTH, HEIGHT, 3)


def pixels(made: XmlStage, points: np.ndarray) -> np.ndarray:
    """(R, 2) of world points (R, 3); the camera is at rest."""
    matrix = made.camera.projection(WIDTH, HEIGHT) @ made.camera.view(0)
    clip = np.concatenate([points, np.ones((len(points), 1))], 1) @ matrix.T
    return clip[:, :2] / clip[:, 3:] * (WIDTH, HEIGHT)


@pytest.mark.slow
def test_motion_and_shadows_of_a_part_that_moves_by_itself(tmp_path: Path):
    """By hand, frame after frame and back again: no frame depends on those before."""
    made = staged(tmp_path)
    numbers = {obj.name: number + 1 for number, obj in enumerate(made.objects)}
    for time in (4, 5, 2):
        clean, (sample,) = noisy(made, time, [time])
        assert set(np.unique(clean["instance"])) == {*numbers.values()}
        plate = clean["instance"][0] == numbers["plate"]
        now = clean["position"][:, plate].T.astype(float)
        np.testing.assert_allclose(now[:, 1], PLATE + STEP[1] * time / FRAMES, atol=1e-5)
        for name, sign in (("motion", -1), ("forward_motion", 1)):
            expected = pixels(made, now + sign * STEP / FRAMES) - pixels(made, now)
            np.testing.assert_allclose(clean[name][:, plate].T, expected, atol=1e-3)
            assert np.abs(expected).max() > 0.2
            assert not clean[name][:, ~plate].any()

        moved = STEP * time / FRAMES
        there = clean["position"].reshape(3, -1).T.astype(float)
        blocker = there + (LIGHT - there) * ((PLATE + moved[1]) / LIGHT[1])
        below = (np.abs(blocker - moved)[:, ::2] < 0.32).all(1)  # well in the plate; other shadows are those of balls
        below &= clean["instance"].ravel() == numbers["floor"]
        before = LIGHT + (blocker - STEP / FRAMES - LIGHT) * (LIGHT[1] / (LIGHT[1] - (blocker - STEP / FRAMES)[:, 1:2]))
        lit = sample["visibility"].ravel() == 1
        assert lit[below].mean() < 0.3  # samples of the plate, in pixels at its edge
        below &= ~lit
        expected = pixels(made, before[below]) - pixels(made, there[below])
        assert below.sum() > 20
        assert np.abs(sample["shadow_motion"].reshape(2, -1).T[below] - expected).max() < 0.03
        assert np.abs(expected).max() > 0.2


@pytest.mark.slow
def test_a_frame_is_one_rebuild(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    made, rebuilt = staged(tmp_path), []
    move = Levels.move

    def counted(self: Levels, transforms: dict[str, np.ndarray], time: float) -> None:
        rebuilt.append(time)
        move(self, transforms, time)

    monkeypatch.setattr(Levels, "move", counted)
    for time in range(1, 4):
        noisy(made, time, [1])
    assert rebuilt == [1, 0, 2, 3]
    for time in (3, 2):
        with made.at(time):
            assert len(rebuilt) == 4


def test_a_still_scene_is_left_as_it_is(tmp_path: Path):
    still = staged(tmp_path, moving=False)
    with still.at(0) as moment:
        clean = geometry(moment)
        assert moment.scenery.mi_scene.shapes()[0].class_name() == "Rectangle"
    np.testing.assert_array_equal(geometry_at(still, 3)["depth"], clean["depth"])


def test_an_xml_is_loaded_once_to_be_checked_and_rendered(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    write(tmp_path)
    loaded, load = [], loading._load
    monkeypatch.setattr(loading, "_load", lambda animation: loaded.append(animation.xml) or load(animation))
    group = "{scene: moves.yaml, clips: 1, frames: 2, width: 16, height: 12, reference_spp: 2}"
    (tmp_path / "recipe.yaml").write_text(f"name: mine\ntrain: [{group}]")
    (folder,) = render_recipe(tmp_path / "recipe.yaml", tmp_path / "out", progress=False)
    assert Clip(folder).frames == 2
    assert len(loaded) == 1
    assert not loading._kept


def write_mirrors(folder: Path) -> Path:
    """A ball, a box and a bulging mesh on a floor, all more or less mirrors, which move under one lamp."""
    material = (
        '<bsdf type="principled"><rgb name="base_color" value="0.7, 0.5, 0.3"/>'
        '<float name="metallic" value="{}"/><float name="roughness" value="{}"/></bsdf>'
    )
    knob = SceneObject(shapes.sphere(), Material(np.ones((1, 1, 3), np.float32)), still(np.eye(4)))
    make_mesh(knob).write_ply(str(folder / "knob.ply"))
    things = {
        "floor": ("rectangle", '<rotate x="1" angle="-90"/><scale value="6"/>', 0.5, 0.2),
        "ball": ("sphere", '<scale value="0.7"/><translate x="-0.9" y="0.7" z="0.3"/>', 1.0, 0.1),
        "box": ("cube", '<rotate y="1" angle="30"/><scale value="0.4"/><translate x="0.9" y="0.6"/>', 0.0, 0.3),
        "knob": ("ply", '<scale x="0.3" y="0.5" z="0.4"/><translate x="0.2" y="0.5" z="-1.2"/>', 1.0, 0.15),
    }
    parts = "".join(
        f'<shape type="{kind}" id="{name}"><transform name="to_world">{place}</transform>{material.format(*numbers)}'
        + ('<string name="filename" value="knob.ply"/>' if kind == "ply" else "")
        + "</shape>"
        for name, (kind, place, *numbers) in things.items()
    )
    (folder / "scene.xml").write_text(f"""<scene version="3.0.0">
      <sensor type="perspective"><float name="fov" value="45"/><transform name="to_world">
        <lookat origin="0.4, 3, -5" target="0, 0.4, 0" up="0, 1, 0"/></transform></sensor>{parts}
      <shape type="rectangle" id="lamp"><transform name="to_world"><rotate x="1" angle="90"/><scale value="0.5"/>
        <translate y="4"/></transform><emitter type="area"><rgb name="radiance" value="20"/></emitter></shape>
      </scene>""")
    (folder / "moves.yaml").write_text("""xml: scene.xml
objects:
  ball: [{frame: 0}, {frame: 10, translate: [0.6, 0.2, 0.5]}]
  box: [{frame: 0}, {frame: 10, translate: [-0.5, 0.3, -0.4], rotate: [20, 60, 0]}]
  knob: [{frame: 0}, {frame: 10, translate: [0.4, 0.1, 0.3], rotate: [0, 40, 30]}]
camera:
- {frame: 0, origin: [0.4, 3, -5], target: [0, 0.4, 0], up: [0, 1, 0]}
- {frame: 10, origin: [0, 3.2, -5], target: [0.1, 0.4, 0], up: [0, 1, 0]}
""")
    return folder / "moves.yaml"


@pytest.mark.slow
def test_every_channel_is_that_of_one_level(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Mirrors, vectors and gradients too, on what moves and beside it, with the same random numbers."""
    animation = read_animation(write_mirrors(tmp_path))
    two = XmlStage(animation, WIDTH, HEIGHT, 4)
    clean, (sample,) = noisy(two, 4, [5])
    with two.at(4) as moment:
        assert len(moment.scenery.levels) == 2
    monkeypatch.setattr("nte.render.engine.xml.stage.levels", lambda *_: [])
    expected_clean, (expected_sample,) = noisy(XmlStage(animation, WIDTH, HEIGHT, 4), 4, [5])
    for name, expected in (expected_clean | expected_sample).items():
        found = (clean | sample)[name]
        known = np.isfinite(expected).all(0)
        assert (np.isfinite(found).all(0) == known).mean() > 0.999, name
        known &= np.isfinite(found).all(0)
        off = np.abs(found - expected).max(0)[known] > 1e-3 * np.maximum(1, np.abs(expected).max(0)[known])
        assert off.mean() < 0.005, name  # paths that rounding sends elsewhere
    moving = clean["instance"][0] > 1
    assert np.isfinite(sample["reflection_motion"][:, moving]).all(0).mean() > 0.5
    assert np.isfinite(sample["gradient"][:, moving]).all(0).sum() > 10
