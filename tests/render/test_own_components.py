"""Light components of somebody else's XML: those of the same scene as a family would have it, and of any shape."""

from pathlib import Path

import numpy as np
import pytest

from nte.frames import Clip
from nte.render.components.frame import noisy, references
from nte.render.engine.mesh_stage import MeshStage
from nte.render.engine.plugins import make_mesh
from nte.render.engine.xml.stage import XmlStage
from nte.render.passes.radiance import radiance
from nte.render.recipes.clips import render_recipe
from nte.render.scenes import shapes
from nte.render.world.keyframes import read_animation
from nte.render.world.scene import Camera, Material, Scene, SceneObject
from nte.render.world.transforms import look_at, rotation, still, translation
from tests.render.test_own import write_room

SIZE, SPP = 40, 256
MATERIALS = {
    "floor": {"color": 0.6},
    "ball": {"color": 0.5, "surface": "metal", "roughness": 0.15},
    "knob": {"color": 0.3, "surface": "glossy", "roughness": 0.2},
    "plate": {"color": 0.7},
    "lamp": {"color": 0.5, "radiance": 9.0},
}
MOVES = {"ball": (0.06, 0.0, 0.03), "plate": (0.05, 0.02, -0.04), "lamp": (-0.04, 0.0, 0.05)}
EYE, TARGET = np.array([0.3, 2.2, -4.5]), np.array([0.0, 0.6, 0.0])


def meshes() -> dict[str, shapes.Mesh]:
    square = shapes.rectangle((-1, 0, 1), (2, 0, 0), (0, 0, -2))
    return {
        "floor": shapes.rectangle((-4, 0, 4), (8, 0, 0), (0, 0, -8)),
        "ball": shapes.sphere(),
        "knob": shapes.sphere(),
        "plate": square,
        "lamp": square,
    }


def place(name: str) -> np.ndarray:
    return {
        "floor": np.eye(4),
        "ball": translation((-0.8, 0.7, 0.2)) @ np.diag([0.7, 0.7, 0.7, 1]),
        "knob": translation((0.9, 0.6, 0.4)) @ rotation((0, 0, 1), 0.4) @ np.diag([0.6, 0.6, 0.6, 1]),
        "plate": translation((0.3, 1.5, -0.3)) @ np.diag([0.4, 0.4, 0.4, 1]),
        "lamp": translation((0.4, 4.0, 0.3)) @ rotation((1, 0, 0), np.pi) @ np.diag([0.1, 0.1, 0.1, 1]),
    }[name]


def family() -> MeshStage:
    def thing(name: str) -> SceneObject:
        given = {"color": np.full((1, 1, 3), MATERIALS[name]["color"], np.float32)} | {
            key: MATERIALS[name][key] for key in ("surface", "roughness") if key in MATERIALS[name]
        }
        step = np.array(MOVES.get(name, (0, 0, 0)))
        track = lambda time: translation(step * time) @ place(name)  # noqa: E731
        light = MATERIALS[name].get("radiance")
        return SceneObject(meshes()[name], Material(**given), track, light and (light,) * 3)

    scene = Scene(tuple(map(thing, MATERIALS)), Camera(still(look_at(EYE, TARGET)), 45.0))
    return MeshStage(scene, SIZE, SIZE, 4)


def own(folder: Path, solid_ball: bool = False) -> XmlStage:
    """The same as XML and keyframes; the ball a mesh as there, or a sphere of Mitsuba's."""
    parts = []
    for name, obj in zip(MATERIALS, family().scene.objects, strict=True):
        make_mesh(obj).write_ply(str(folder / f"{name}.ply"))
        given, matrix = MATERIALS[name], " ".join(f"{value:.9g}" for value in place(name).ravel())
        grey = f'<rgb name="{{}}" value="{given["color"]}"/>'
        bsdf = f'<bsdf type="diffuse">{grey.format("reflectance")}</bsdf>'
        if "surface" in given:
            numbers = {"roughness": given["roughness"], "metallic": float(given["surface"] == "metal")}
            floats = "".join(f'<float name="{key}" value="{value}"/>' for key, value in numbers.items())
            bsdf = f'<bsdf type="principled">{grey.format("base_color")}{floats}</bsdf>'
        light = f'<emitter type="area"><rgb name="radiance" value="{given.get("radiance")}"/></emitter>'
        file = f'<string name="filename" value="{name}.ply"/>'
        kind, file = ("sphere", "") if solid_ball and name == "ball" else ("ply", file)
        parts.append(
            f'<shape type="{kind}" id="{name}">{file}<transform name="to_world"><matrix value="{matrix}"/></transform>'
            f"{bsdf}{light if 'radiance' in given else ''}</shape>"
        )
    origin, target = (", ".join(map(str, point)) for point in (EYE, TARGET))
    sensor = (
        '<sensor type="perspective"><float name="fov" value="45"/><string name="fov_axis" value="x"/><transform '
        f'name="to_world"><lookat origin="{origin}" target="{target}" up="0, 1, 0"/></transform></sensor>'
    )
    (folder / "scene.xml").write_text(f'<scene version="3.0.0">{sensor}{"".join(parts)}</scene>')
    keys = [
        f"  {name}: [{{frame: 0}}, {{frame: 10, translate: {[10 * x for x in step]}}}]" for name, step in MOVES.items()
    ]
    (folder / "moves.yaml").write_text("xml: scene.xml\nobjects:\n" + "\n".join(keys))
    return XmlStage(read_animation(folder / "moves.yaml"), SIZE, SIZE, 4)


@pytest.fixture(scope="module")
def every_kind(tmp_path_factory: pytest.TempPathFactory) -> XmlStage:
    folder = write_room(tmp_path_factory.mktemp("every kind"))
    return XmlStage(read_animation(folder / "moves.yaml"), 96, 64, 4)


def test_the_same_scene_as_xml_has_the_same_channels(tmp_path: Path):
    """With the same random numbers: all but some paths that rounding sends elsewhere."""
    theirs, mine = (noisy(made, 3, [5]) for made in (family(), own(tmp_path)))
    for name, expected in (theirs[0] | theirs[1][0]).items():
        found = (mine[0] | mine[1][0])[name]
        shown = np.isfinite(expected).all(0)
        if name.startswith("gradient"):  # a stratum's choice may fall on another of its pixels
            assert abs(np.isfinite(found).all(0).sum() - shown.sum()) <= 2
        alike = np.isclose(found, expected, rtol=2e-3, atol=2e-3, equal_nan=True).all(0)
        assert alike.mean() > 0.995, name
        assert (alike & shown).sum() > 0.98 * shown.sum() > 0, name


def test_a_sphere_bends_reflections_as_its_mesh_does(tmp_path: Path):
    (tmp_path / "mesh").mkdir()
    (tmp_path / "solid").mkdir()
    meshed, solid = (noisy(own(tmp_path / kind, kind == "solid"), 3, [5]) for kind in ("mesh", "solid"))
    ball = (meshed[0]["instance"] == 2)[0] & (solid[0]["instance"] == 2)[0]
    for name, least in (("reflection_motion", 0.1), ("reflection_covariance", 0.2)):
        first, second = (sample[1][0][name][:, ball] for sample in (meshed, solid))
        shown = np.isfinite(first).all(0) & np.isfinite(second).all(0)
        assert shown.sum() > 30
        scale = 1 if name == "reflection_motion" else np.median(np.abs(first[:, shown]).max(0))
        error = np.abs(first - second).max(0)[shown] / scale
        assert np.median(error) < least / 4
        assert np.quantile(error, 0.8) < least


@pytest.mark.slow
def test_components_of_a_scene_of_all_kinds_sum_to_a_plain_path_trace(every_kind: XmlStage):
    """Two-sided and textured paint, gold, glass, instances, a panel, a bulb that moves, and a sky."""
    with every_kind.at(3) as moment:
        found, plain = references(moment, SPP, (1, 2)), radiance(moment, SPP, 9)
    clean, (sample,) = noisy(every_kind, 3, [4])
    np.testing.assert_allclose((found["reference_a"] + found["reference_b"]).mean() / 2, plain.mean(), rtol=5e-3)
    direct = clean["direct"] * found["reference_visibility"]
    whole = clean["emission"] + direct + found["reference_indirect"] + found["reference_glossy"]
    np.testing.assert_allclose(whole.mean(), plain.mean(), rtol=1e-2)
    names = [obj.name for obj in every_kind.objects]
    for name in ("round", "clear"):  # no diffuse lobe
        inside = clean["instance"][0] == names.index(name) + 1
        assert (sample["indirect"][:, inside] == 0).mean() > 0.9  # but at its edge
        assert sample["glossy"][:, inside].mean() > 0.05


HIGH, PLATE = 4.0, 1.5  # of the bulb and of the plate over the floor


def bulb(time: float) -> np.ndarray:
    return np.array([0.5 - 0.06 * time, HIGH, 0.2 + 0.02 * time])


def sun(time: float) -> np.ndarray:
    return rotation((0, 1, 0), np.radians(-6 * time))[:3, :3] @ [0.3, -1, -0.2]


LIGHTS = {  # the light in the XML, its keyframe of frame 10, plate over floor point, floor point below plate
    "point": (
        f'<point name="position" x="0.5" y="{HIGH}" z="0.2"/><rgb name="intensity" value="9"/>',
        "translate: [-0.6, 0, 0.2]",
        lambda time, floor: floor + (bulb(time) - floor) * PLATE / HIGH,
        lambda time, plate: bulb(time) + (plate - bulb(time)) * HIGH / (HIGH - PLATE),
    ),
    "directional": (
        '<vector name="direction" x="0.3" y="-1" z="-0.2"/><rgb name="irradiance" value="3"/>',
        "rotate: [0, -60, 0]",
        lambda time, floor: floor - sun(time) * PLATE,
        lambda time, plate: plate + sun(time) * PLATE,
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", LIGHTS)
def test_shadow_of_a_light_that_is_no_shape(tmp_path: Path, kind: str):
    """Its vectors follow the light's own keyframes. By hand: a plate over a parallel floor; plate and light move."""
    light, moves, over, below = LIGHTS[kind]
    (tmp_path / "scene.xml").write_text(f"""<scene version="3.0.0">
      <sensor type="perspective"><float name="fov" value="45"/><transform name="to_world">
        <lookat origin="0, 6, -0.5" target="0, 0, 0" up="0, 0, 1"/></transform></sensor>
      <shape type="rectangle" id="floor"><transform name="to_world"><rotate x="1" angle="-90"/>
        <scale value="6"/></transform></shape>
      <shape type="rectangle" id="plate"><transform name="to_world"><rotate x="1" angle="-90"/>
        <scale value="0.4"/><translate y="{PLATE}"/></transform></shape>
      <emitter type="{kind}" id="light">{light}</emitter></scene>""")
    (tmp_path / "moves.yaml").write_text(f"""xml: scene.xml
objects: {{plate: [{{frame: 0}}, {{frame: 10, translate: [0.4, 0, 0.3]}}]}}
lights: {{light: [{{frame: 0}}, {{frame: 10, {moves}}}]}}""")
    made = XmlStage(read_animation(tmp_path / "moves.yaml"), SIZE, SIZE, 3)
    clean, (sample,) = noisy(made, 4, [1])
    camera = made.camera
    matrix = camera.projection(SIZE, SIZE) @ camera.view(4)

    def pixels(points: np.ndarray) -> np.ndarray:
        clip = np.concatenate([points, np.ones((len(points), 1))], 1) @ matrix.T
        return clip[:, :2] / clip[:, 3:] * SIZE

    shadowed = (sample["visibility"][0] == 0) & (clean["instance"][0] == 1)
    now = clean["position"][:, shadowed].T.astype(float)
    before = below(3, over(4, now) - (0.04, 0, 0.03))
    expected = pixels(before) - pixels(now)
    assert shadowed.sum() > 20
    assert np.abs(expected).max() > 0.4
    assert np.abs(sample["shadow_motion"][:, shadowed].T - expected).max() < 0.03


BSDFS = {
    "diffuse": '<bsdf type="diffuse"/>',
    "gold": '<bsdf type="roughconductor"><string name="material" value="Au"/><float name="alpha" value=".1"/></bsdf>',
    "mirror": '<bsdf type="conductor"/>',
}


@pytest.mark.parametrize("name", BSDFS)
def test_gradients_are_over_the_albedo_that_the_guides_show(tmp_path: Path, name: str):
    """Below a constant sky of 1, behind a shutter that the near plane cuts away: every stratum sends out its albedo."""
    lying = '<transform name="to_world"><rotate x="1" angle="-90"/><scale value="{}"/><translate y="{}"/></transform>'
    (tmp_path / "scene.xml").write_text(f"""<scene version="3.0.0">
      <sensor type="perspective"><float name="fov" value="45"/><float name="near_clip" value="3"/>
        <transform name="to_world"><lookat origin="0, 6, -0.5" target="0, 0, 0" up="0, 0, 1"/></transform></sensor>
      <shape type="rectangle" id="floor">{lying.format(6, 0)}{BSDFS[name]}</shape>
      <shape type="rectangle" id="shutter">{lying.format(0.4, 5.5)}</shape><emitter type="constant"/></scene>""")
    (tmp_path / "still.yaml").write_text("xml: scene.xml")
    made = XmlStage(read_animation(tmp_path / "still.yaml"), SIZE, SIZE, 2)
    clean, (sample,) = noisy(made, 1, [2])
    assert (clean["instance"] == 1).all()
    shown = np.isfinite(sample["gradient"]).all(0)
    assert shown.mean() > 0.1
    assert sample["gradient"][0, shown].mean() == pytest.approx(1, abs=0.05)
    np.testing.assert_array_equal(*sample["gradient"][:, shown])


@pytest.mark.slow
def test_a_recipe_with_components_renders_a_scene_of_ones_own(tmp_path: Path):
    own(tmp_path)
    (tmp_path / "recipe.yaml").write_text(
        "name: mine\ntrain: [{scene: moves.yaml, clips: 1, frames: 2, width: 24, height: 16, reference_spp: 8, "
        "components: true}]"
    )
    (folder,) = render_recipe(tmp_path / "recipe.yaml", tmp_path / "out", progress=False)
    names = ["direct", "shadow_motion", "reflection_motion", "gradient"]
    frame = Clip(folder).frame(1, names)
    assert all(np.isfinite(np.asarray(frame[name])).any() for name in names)
