"""Somebody else's XML scene, animated: its vectors are exact, whatever kind of shape moves."""

from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
from PIL import Image

from nte.errors import NteError
from nte.motion.warp import fetch_nearest, pixel_centres, warp
from nte.render.engine.xml.stage import XmlStage
from nte.render.recipes.clips import render_recipe
from nte.render.recipes.thumbnails import thumbnails
from nte.render.world.keyframes import Key, object_track, read_animation
from tests.render.shots import guides_at, radiance_at

ROOM = """\
<scene version="3.0.0">
  <default name="bright" value="5"/>
  <sensor type="perspective" id="eye"><float name="fov" value="50"/>
    <transform name="to_world"><lookat origin="0, 2, -6" target="0, 1, 0" up="0, 1, 0"/></transform></sensor>
  <bsdf type="twosided" id="paint"><bsdf type="diffuse"><texture type="bitmap" name="reflectance">
    <string name="filename" value="textures/paint.png"/></texture></bsdf></bsdf>
  <bsdf type="roughconductor" id="gold"><string name="material" value="Au"/><float name="alpha" value="0.25"/></bsdf>
  <shape type="rectangle" id="floor"><transform name="to_world"><scale value="5"/>
    <rotate x="1" angle="-90"/></transform><ref id="paint"/></shape>
  <shape type="ply" id="mesh"><string name="filename" value="ball.ply"/>
    <transform name="to_world"><scale value="0.5"/><translate x="-1" y="0.5"/></transform><ref id="paint"/></shape>
  <shape type="obj"><string name="filename" value="box.obj"/>
    <transform name="to_world"><translate x="1.5" y="0.5"/></transform><ref id="paint"/></shape>
  <shape type="sphere" id="round"><point name="center" x="0.2" y="0.6" z="-1"/><float name="radius" value="0.5"/>
    <ref id="gold"/></shape>
  <shape type="sphere" id="clear"><point name="center" x="-2" y="2.5" z="0"/><float name="radius" value="0.4"/>
    <bsdf type="dielectric"/></shape>
  <shape type="shapegroup" id="tree">
    <shape type="cylinder"><float name="radius" value="0.1"/><ref id="paint"/></shape>
    <shape type="sphere"><point name="center" x="0" y="0" z="1.2"/><float name="radius" value="0.4"/>
      <ref id="paint"/></shape>
  </shape>
  <shape type="instance" id="oak"><ref id="tree"/>
    <transform name="to_world"><rotate x="1" angle="-90"/><translate x="-2" z="1"/></transform></shape>
  <shape type="instance" id="elm"><ref id="tree"/>
    <transform name="to_world"><rotate x="1" angle="-90"/><translate x="2.4" z="1"/></transform></shape>
  <shape type="rectangle" id="panel"><transform name="to_world"><rotate x="1" angle="90"/><translate y="4"/></transform>
    <emitter type="area"><rgb name="radiance" value="$bright"/></emitter></shape>
  <emitter type="point" id="bulb"><point name="position" x="2" y="3" z="-2"/><rgb name="intensity" value="5"/></emitter>
  <emitter type="envmap" id="sky"><string name="filename" value="textures/sky.exr"/></emitter>
</scene>
"""
MOVES = """\
xml: room.xml
objects:
  floor: [{frame: 0}, {frame: 8, rotate: [0, 20, 0]}]
  mesh: [{frame: 0}, {frame: 8, translate: [1, 0.6, 0], rotate: [0, 90, 30], pivot: [-1, 0.5, 0]}]
  round: [{frame: 0}, {frame: 8, translate: [0, 1.5, 0]}]
  oak: [{frame: 0}, {frame: 8, translate: [0.6, 0, -1], rotate: [0, 60, 0], pivot: [-2, 0, 1]}]
lights:
  bulb: [{frame: 0}, {frame: 8, translate: [-4, 0, 0]}]
camera:
  - {frame: 0, origin: [0, 2, -6], target: [0, 1, 0]}
  - {frame: 8, origin: [1, 2.2, -6], target: [0, 1, 0]}
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_room(tmp_path_factory.mktemp("own"))


def write_room(folder: Path) -> Path:
    """ROOM and MOVES with their files, in `folder`."""
    from nte.frames.exr import write_exr

    (folder / "textures").mkdir()
    coarse = np.random.default_rng(0).integers(0, 255, (6, 6, 3), np.uint8)
    Image.fromarray(coarse).resize((64, 64), Image.Resampling.BICUBIC).save(folder / "textures" / "paint.png")
    write_exr(folder / "textures" / "sky.exr", {name: np.full((8, 16), 0.3, np.float32) for name in "RGB"})
    trimesh.creation.uv_sphere(count=[12, 24]).export(folder / "ball.ply")
    trimesh.creation.box().export(folder / "box.obj")
    (folder / "room.xml").write_text(ROOM)
    (folder / "moves.yaml").write_text(MOVES)
    return folder


@pytest.fixture(scope="module")
def stage(folder: Path) -> XmlStage:
    return XmlStage(read_animation(folder / "moves.yaml"), 96, 64, 4)


def seen(stage: XmlStage, time: float) -> dict[str, torch.Tensor]:
    return {name: torch.from_numpy(values)[None] for name, values in guides_at(stage, time).items()}


def test_every_shape_and_instance_is_an_object_of_its_own(stage: XmlStage) -> None:
    names = [obj.name for obj in stage.objects]
    assert {"floor", "mesh", "round", "clear", "oak", "elm", "panel"} < {*names}
    visible = np.unique(seen(stage, 0)["instance"].numpy())
    assert {names[int(number) - 1] for number in visible if number} == {*names} - {"panel"}


@pytest.mark.parametrize("name", ["floor", "mesh", "round", "oak", "elm"])
def test_motion_leads_to_the_same_point_of_the_object(stage: XmlStage, name: str) -> None:
    """The world point that was seen there, carried on by the object's own motion, is the point that is seen now."""
    before, now = seen(stage, 3), seen(stage, 4)
    number = [obj.name for obj in stage.objects].index(name)
    track = stage.objects[number].track
    onward = np.eye(4) if track is None else track(4) @ np.linalg.inv(track(3))
    there = pixel_centres(now["motion"]) + now["motion"]
    mine = (now["instance"] == number + 1) & (fetch_nearest(before["instance"], there) == number + 1)
    fetched = warp(before["position"], now["motion"])
    mine &= fetched.valid & (warp(before["instance"], now["motion"]).image == number + 1)
    assert mine.sum() > 20
    points = fetched.image[0][:, mine[0, 0]].numpy().T
    carried = points @ onward[:3, :3].T + onward[:3, 3]
    # The fetched point is a mean of four that are seen in perspective, on a curved surface a little below it.
    here = now["position"][0][:, mine[0, 0]].numpy().T
    assert np.linalg.norm(carried - here, axis=1).mean() < 0.015
    assert np.linalg.norm(carried - here, axis=1).max() < 0.06
    assert (np.linalg.norm(points - here, axis=1).mean() > 0.04) == (track is not None)


def test_guides_of_metal_and_glass(stage: XmlStage) -> None:
    frame, names = seen(stage, 0), [obj.name for obj in stage.objects]
    inside = {name: (frame["instance"] == names.index(name) + 1)[0, 0] for name in ("round", "clear")}
    gold, glass = ({key: frame[key][0][:, mask].median(1).values for key in frame} for mask in inside.values())
    assert gold["albedo"][0] > 0.9
    assert gold["albedo"][2] < 0.6
    assert gold["roughness"] == pytest.approx(0.5, abs=1e-3)
    assert (glass["albedo"] > 0.99).all()
    assert glass["roughness"] == 0


def test_lights_move_and_defaults_have_values(folder: Path) -> None:
    def light(text: str, time: float) -> np.ndarray:
        (folder / "light.yaml").write_text(text)
        stage = XmlStage(read_animation(folder / "light.yaml"), 32, 24, 3)
        return radiance_at(stage, time, 64, 1)

    still = "xml: room.xml\nlights:\n  bulb: [{frame: 0}, {frame: 8, translate: [-4, 0, 0]}]\n"
    before, after = (light(still + "values: {bright: '0'}\n", time) for time in (0, 8))
    # The bulb goes from x = 2 to −2; the camera looks along +z, so +x is on the left of the image.
    change = after - before
    assert change[..., :16].mean() < -0.005 < 0.005 < change[..., 16:].mean()
    assert light(still, 0).mean() > 1.1 * before.mean()


def test_smooth_tracks_pass_through_their_keyframes_without_a_jump_of_speed() -> None:
    keys = [Key(0.0), Key(4.0, [1.0, 2.0, 0.0]), Key(10.0, [0.0, 5.0, 0.0], [0.0, 90.0, 0.0])]
    for kind in ("linear", "smooth"):
        track = object_track(keys, kind)
        for key in keys:
            np.testing.assert_allclose(track(key.frame)[:3, 3], key.translate, atol=1e-9)
        np.testing.assert_allclose(track(-3), track(0))
        np.testing.assert_allclose(track(12), track(10))
    before, after = (object_track(keys, "smooth")(4 + h)[:3, 3] - [1, 2, 0] for h in (-1e-5, 1e-5))
    np.testing.assert_allclose(-before, after, rtol=1e-3, atol=1e-9)


# As found in public scenes: nothing has a name, the camera mirrors, and there are plugins that this Mitsuba has not.
UNNAMED = """\
<scene version="2.0.0">
  <path value="textures"/>
  <integrator type="bidirectional"/>
  <sensor type="perspective"><string name="fov_axis" value="smaller"/><float name="fov" value="40"/>
    <transform name="to_world"><scale x="-1"/><lookat origin="0, 1, -6" target="0, 1, 0" up="0, 1, 0"/></transform>
    <sampler type="halton"/><film type="hdrfilm"><rfilter type="tent"/></film></sensor>
  <shape type="ply"><string name="filename" value="ball.ply"/>
    <transform name="to_world"><translate x="1.5" y="1"/></transform>
    <bsdf type="roughconductor"><float name="alpha_u" value="0.04"/><float name="alpha_v" value="0.25"/></bsdf></shape>
  <shape type="ply"><string name="filename" value="ball.ply"/>
    <transform name="to_world"><translate x="-1.5" y="1"/></transform>
    <bsdf type="diffuse"><texture type="bitmap" name="reflectance"><string name="filename" value="paint.png"/></texture>
    </bsdf></shape>
  <shape type="rectangle"><transform name="to_world"><rotate x="1" angle="90"/><translate y="5"/></transform>
    <emitter type="area"/></shape>
  <emitter type="point"><point name="position" x="2" y="3" z="-2"/></emitter>
  <emitter type="point"><point name="position" x="-2" y="3" z="-2"/></emitter>
</scene>
"""
UNNAMED_MOVES = """\
xml: unnamed.xml
objects: {ball_2: [{frame: 0}, {frame: 4, translate: [0, 0, -1]}]}
lights: {point_2: [{frame: 0}, {frame: 4, translate: [0, 1, 0]}]}
camera: [{frame: 0, origin: [0, 1, -6], target: [0, 1, 0]}]
"""


def test_an_xml_without_names_needs_no_editing(folder: Path) -> None:
    (folder / "unnamed.xml").write_text(UNNAMED)
    (folder / "unnamed.yaml").write_text(UNNAMED_MOVES)
    stage = XmlStage(read_animation(folder / "unnamed.yaml"), 60, 40, 3)
    names = [obj.name for obj in stage.objects]
    assert sorted(names) == ["ball", "ball_2", "rectangle"]
    frame = seen(stage, 2)
    number = {name: names.index(name) + 1 for name in names}
    columns = {name: np.nonzero(frame["instance"][0, 0].numpy() == number[name])[1] for name in ("ball", "ball_2")}
    # The camera looks along +z: +x would be on its left, and is on the right of a mirrored image.
    assert columns["ball_2"].max() < 30 <= columns["ball"].min()
    moving = frame["motion"].abs().amax(1)[0] > 0.01
    assert moving[frame["instance"][0, 0] == number["ball_2"]].float().mean() > 0.9
    assert not moving[frame["instance"][0, 0] == number["ball"]].any()
    rough = frame["roughness"][frame["instance"] == number["ball"]].median()
    assert float(rough) == pytest.approx(0.1**0.5, abs=1e-3)


@pytest.mark.slow
def test_clips_follow_each_other_and_pass_the_check(folder: Path, tmp_path: Path) -> None:
    from nte.checking import check
    from nte.frames.clip import Clip

    (folder / "recipe.yaml").write_text(
        "name: own\ntrain:\n  - {scene: moves.yaml, clips: 2, frames: 2, width: 64, height: 48, reference_spp: 4}\n"
        "test:\n  - {scene: moves.yaml, clips: 1, frames: 1, width: 32, height: 24, reference_spp: 128, shutter: 1}\n"
    )
    render_recipe(folder / "recipe.yaml", tmp_path / "out", progress=False)
    first, second = (Clip(tmp_path / "out" / "train" / f"moves_00{number}") for number in (0, 1))
    assert check(first).verdict == "plausible"
    step = np.subtract(second.info["cameras"][0]["view"], first.info["cameras"][1]["view"])
    assert 0 < np.abs(step).max() < 0.2  # the next frame of the same way
    blurred = Clip(tmp_path / "out" / "test" / "moves_000").frame(0)
    sharp = Clip(tmp_path / "out" / "sharp" / "test" / "moves_000").frame(0)
    close = np.abs(blurred["shutter_motion"] - sharp["shutter_motion"]).max(1) < 1
    assert close.mean() > 0.9  # but for samples of another surface
    assert np.abs(sharp["shutter_motion"]).max() > 1


def test_a_mesh_that_would_be_read_without_end_is_refused(tmp_path: Path) -> None:
    mesh = "<shape type='ply'><string name='filename' value='/dev/zero'/></shape>"
    (tmp_path / "endless.xml").write_text(f"<scene version='3.0.0'>{mesh}</scene>")
    (tmp_path / "moves.yaml").write_text("xml: endless.xml")
    with pytest.raises(NteError, match=r"endless\.xml: filename /dev/zero is no file"):
        XmlStage(read_animation(tmp_path / "moves.yaml"), 8, 8, 2)


def test_an_xml_file_that_would_end_the_process_is_refused(tmp_path: Path) -> None:
    (tmp_path / "deep.xml").write_text("<scene version='3.0.0'>" + "<shape type='sphere'>" * 20_000)
    (tmp_path / "around.xml").write_text("<scene version='3.0.0'><include filename='deep.xml'/></scene>")
    (tmp_path / "below").mkdir()
    (tmp_path / "below" / "buried.xml").write_bytes((tmp_path / "deep.xml").read_bytes())
    found = "<path value='below'/><include filename='buried.xml'/>"  # in a folder that the scene itself names
    (tmp_path / "beside.xml").write_text(f"<scene version='3.0.0'>{found}</scene>")
    (tmp_path / "latin.xml").write_bytes(
        "<scene version='3.0.0'><shape type='cube' id='Würfel'/></scene>".encode("latin-1")
    )
    for name, said in {
        "deep": r"deep\.xml: nested too deeply", "around": r"deep\.xml: nested too deeply",
        "beside": r"buried\.xml: nested too deeply", "latin": "not UTF-8",
    }.items():  # fmt: skip
        (tmp_path / "moves.yaml").write_text(f"xml: {name}.xml")
        with pytest.raises(NteError, match=said):
            XmlStage(read_animation(tmp_path / "moves.yaml"), 8, 8, 2)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (MOVES.replace("  round:", "  rund:"), "objects names 'rund', none .*floor, mesh, box, round"),
        (MOVES.replace("bulb:", "lamp:"), "lights names 'lamp', none .*: there is bulb, sky"),
        (MOVES.replace("translate: [0, 1.5, 0]", "scale: [1, 0, 1]"), "objects.round.1..scale is .*singular"),
        (MOVES.replace("target: [0, 1, 0]}", "target: [0, 2, -6]}", 1), "camera.0.: origin, target and up lie on one"),
        (MOVES.replace("{frame: 8, translate: [-4, 0, 0]}", "{frame: 0}"), "lights.bulb.1..frame is 0 after 0"),
        (MOVES.replace("rotate: [0, 20, 0]", "rotate: [0, 20]"), "objects.floor.1..rotate is .*expected three numbers"),
        (
            MOVES.replace("rotate: [0, 20, 0]", "rotate: [0, [20], 0]"),
            "'objects.floor.1..rotate.1.': .20. is given, exp",
        ),
        (MOVES.replace("room.xml", "attic.xml"), "attic.xml is no file"),
        (MOVES + "interpolation: wobbly\n", "interpolation is 'wobbly'"),
        (MOVES + "lamps: {}\n", "lamps"),
        (MOVES.replace("[-4, 0, 0]", "[-4, 0, 0], brightness: -1"), "lights.bulb.1..brightness is -1.*at least 0"),
        (MOVES.replace("[0, 20, 0]", "[0, 20, 0], brightness: 2"), "'floor' has a brightness, but sends out no light"),
        (MOVES.replace("translate: [0, 1.5, 0]", "scale: [1, 2, 1]"), "'round' is a sphere: expected the same scale"),
        (MOVES.replace("rotate: [0, 20, 0]", "scale: [1, 1, -1]"), "objects.floor.0..scale passes 0 on the way"),
        (
            MOVES.replace(
                "{frame: 8, rotate: [0, 20, 0]}",
                "".join(
                    f"{{frame: {frame}, scale: [{scale}, 1, 1]}}, " for frame, scale in ((4, 0.05), (8, 0.05), (12, 1))
                ),
            )
            + "interpolation: smooth\n",
            "objects.floor.1..scale passes 0 .*swing",
        ),
    ],
)
def test_a_faulty_animation_is_one_line(folder: Path, text: str, said: str) -> None:
    (folder / "faulty.yaml").write_text(text)
    with pytest.raises(NteError, match=said) as error:
        XmlStage(read_animation(folder / "faulty.yaml"), 8, 8, 2)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("ball.ply", "bull.ply", "bull.ply.*not found"),
        ("textures/paint.png", "paint.png", "paint.png.*No such file"),
        ("</scene>", "", "room.xml.*Pars"),
        ('type="perspective" id="eye"><float name="fov" value="50"/>', 'type="orthographic">', "sensor is .*expected"),
        ('<ref id="gold"/>', '<ref id="silver"/>', "silver"),
        ('name="alpha" value="0.25"', 'name="alhpa" value="0.25"', "unreferenced property.*alhpa"),
        ('<scale value="5"/>', '<scale x="5" y="0" z="5"/>', "to_world of 'floor' is singular"),
        ("<scene version", "<shape version", "room.xml"),
    ],
)
def test_a_faulty_scene_is_one_line(folder: Path, tmp_path: Path, old: str, new: str, said: str) -> None:
    for name in ("textures", "ball.ply", "box.obj"):
        (tmp_path / name).symlink_to(folder / name)
    (tmp_path / "room.xml").write_text(ROOM.replace(old, new))
    (tmp_path / "moves.yaml").write_text(MOVES)
    with pytest.raises(NteError, match=said) as error:
        XmlStage(read_animation(tmp_path / "moves.yaml"), 8, 8, 2)
    assert "\n" not in str(error.value)


def test_a_recipe_says_what_does_not_go_with_a_scene_of_ones_own(folder: Path, tmp_path: Path) -> None:
    for rest, said in (
        ("parameters: {speed: 2}", "expected nothing but 'start'"),
        ("parameters: {start: soon}", "expected nothing but 'start'"),
    ):
        (folder / "bad.yaml").write_text(f"name: bad\ntrain:\n  - {{scene: moves.yaml, clips: 1, {rest}}}\n")
        with pytest.raises(NteError, match=said):
            render_recipe(folder / "bad.yaml", tmp_path / "out", progress=False)
    fog = '<medium type="homogeneous" name="interior"/></shape></scene>'
    (folder / "fog.xml").write_text(ROOM.replace("</scene>", f'<shape type="cube"><bsdf type="null"/>{fog}'))
    (folder / "fog.yaml").write_text("xml: fog.xml")
    (folder / "bad.yaml").write_text("name: bad\ntrain:\n  - {scene: fog.yaml, clips: 1, components: true}\n")
    with pytest.raises(NteError, match=r"fog.xml: light in its media has no components"):
        render_recipe(folder / "bad.yaml", tmp_path / "out", progress=False)
    dark = ROOM.replace('<emitter type="area"><rgb name="radiance" value="$bright"/></emitter>', "")
    lines = [line for line in dark.splitlines() if "<emitter" not in line and "$bright" not in line]
    (folder / "dark.xml").write_text("\n".join(line for line in lines if "<default" not in line))
    (folder / "fog.yaml").write_text("xml: dark.xml")
    with pytest.raises(NteError, match=r"dark.xml: has no light: expected components: false"):
        render_recipe(folder / "bad.yaml", tmp_path / "out", progress=False)
    (folder / "bad.yaml").write_text("name: bad\ntrain:\n  - {scene: nowhere.yaml, clips: 1}\n")
    with pytest.raises(NteError, match=r"train\[0\].scene: .*nowhere.yaml is no file"):
        render_recipe(folder / "bad.yaml", tmp_path / "out", progress=False)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("name", ["bulb", "sky", "panel"])
def test_lights_change_their_brightness(folder: Path, name: str) -> None:
    """Of a light without a shape, of one with a texture, and of a shape that is one; the others are put out."""

    def keys(light: str) -> str:
        ends = (1, 3) if light == name else (0, 0)
        return f"{{{light}: [{{frame: 0, brightness: {ends[0]}}}, {{frame: 8, brightness: {ends[1]}}}]"

    bulb_and_sky = f"{keys('bulb')}, {keys('sky')[1:]}}}"
    (folder / "bright.yaml").write_text(f"xml: room.xml\nobjects: {keys('panel')}}}\nlights: {bulb_and_sky}\n")
    lit, means = XmlStage(read_animation(folder / "bright.yaml"), 24, 16, 3), []
    for time in (0, 4, 8, 0):
        means.append(radiance_at(lit, time, 64, 5).mean())
    assert means[0] > 0.001
    np.testing.assert_allclose(np.divide(means, means[0]), (1, 2, 3, 1), rtol=1e-4)


_SENSOR = """<sensor type="perspective"><float name="{fov}" value="40"/>{more}<transform name="{place}">
  <lookat origin="0, 1, -5" target="0, 0, 0" up="0, 1, 0"/></transform>{film}</sensor>"""
_BALL = '<shape type="sphere"><bsdf type="diffuse"/>{}</shape><emitter type="constant"/>'
_SIZED = '<integer name="width" value="300"/><integer name="height" value="100"/>'
_BY_HEIGHT = '<string name="fov_axis" value="y"/>'
WIDE = np.degrees(2 * np.arctan(3 * np.tan(np.radians(20))))  # 40° are along the side three times shorter
ODD_FILTER = '<rfilter type="odd"><float name="q" value="1"/></rfilter>'
ODD_FORMAT = '<string name="pixel_format" value="odd"/>'
OLD_FILM = f'<film type="ldrfilm">{_SIZED}<boolean name="banner" value="false"/><rfilter type="gaussian"/></film>'
UNUSED = {  # what nte does not use → version, the head of the scene, the sensor's film, more of the sensor, of the ball
    "a film of old": ("3.0.0", "", f'<film type="ldrfilm">{_SIZED}<float name="gamma" value="2.2"/></film>', "", ""),
    "a filter": ("3.0.0", "", f'<film type="hdrfilm">{ODD_FILTER}</film>', "", ""),
    "the film's settings": ("3.0.0", "", f'<film type="hdrfilm">{ODD_FORMAT}</film>', "", ""),
    "a film by reference": ("3.0.0", '<film type="ldrfilm" id="f"/>', '<ref id="f"/>', "", ""),
    "a film by parameter": ("3.0.0", '<default name="film" value="ldrfilm"/>', '<film type="$film"/>', "", ""),
    "an integrator": ("3.0.0", '<integrator type="vcm"><integer name="depth" value="3"/></integrator>', "", "", ""),
    "a sampler": ("3.0.0", "", '<sampler type="sobolx"/>', "", ""),
    "a second sensor": ("3.0.0", "", "", "", '</shape><sensor type="odd"/><shape type="sphere">'),
    "a sensor on a shape": ("3.0.0", "", "", "", '<sensor type="irradiancemeter"><film type="odd"/></sensor>'),
    "a material": ("3.0.0", '<bsdf type="irawan" id="cloth"><string name="file" value="x"/></bsdf>', "", "", ""),
    "a medium": ("3.0.0", '<medium type="odd" id="fog"/>', "", "", ""),
    "an include": ("3.0.0", '<include filename="part.xml"/>', "", "", ""),
    "an alias": ("3.0.0", '<bsdf type="odd" id="a"/><alias id="a" as="b"/>', "", "", ""),
    "all of 0.5": ("0.5.0", '<integrator type="path"><integer name="maxDepth" value="3"/></integrator>',
                   f'{OLD_FILM}<sampler type="ldsampler"><integer name="sampleCount" value="4"/></sampler>',
                   '<string name="fovAxis" value="smaller"/>', ""),
    "a field of view by height": ("3.0.0", "", f'<film type="odd">{_SIZED}</film>', _BY_HEIGHT, ""),
}  # fmt: skip


@pytest.mark.parametrize("name", UNUSED)
def test_what_is_not_used_is_not_loaded(tmp_path: Path, name: str) -> None:
    version, head, film, more, ball = UNUSED[name]
    place = "toWorld" if version < "2" else "to_world"
    sensor = _SENSOR.format(fov="fov", more=more, place=place, film=film)
    part = '<scene version="3.0.0"><integrator type="odd"/><film type="odd" id="f"/></scene>'
    (tmp_path / "part.xml").write_text(part)
    (tmp_path / "scene.xml").write_text(f'<scene version="{version}">{head}{sensor}{_BALL.format(ball)}</scene>')
    (tmp_path / "still.yaml").write_text("xml: scene.xml")
    made = XmlStage(read_animation(tmp_path / "still.yaml"), 8, 6, 2)
    assert not made.media
    assert made.camera.fov == pytest.approx(WIDE if more else 40, abs=1e-3)
    assert radiance_at(made, 0, 4, 1).mean() > 0.1


def test_a_strip_of_pictures_has_the_name_of_the_scene(folder: Path, tmp_path: Path) -> None:
    recipe = tmp_path / "recipes" / "own.yaml"
    recipe.parent.mkdir()
    recipe.write_text(
        f"name: own\ntrain: [{{scene: {folder}/moves.yaml, clips: 1, frames: 2, parameters: {{start: 1}}}}]"
    )
    (made,) = thumbnails(recipe, tmp_path / "out", size=8, spp=1)
    assert made == tmp_path / "out" / "moves-start-1.png"
    assert Image.open(made).size == (32, 8)
