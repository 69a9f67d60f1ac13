"""The diffuse lobe's reflectance and the surface's own normal, on surfaces whose answer is known."""

from pathlib import Path

import numpy as np
import pytest

from nte.filters.trmv import Trmv
from nte.filters.trmv.options import TrmvOptions
from nte.frames import CHANNELS, Frame
from nte.frames.exr import write_exr
from nte.render.components.frame import noisy
from nte.render.engine.mesh_stage import MeshStage
from nte.render.engine.xml.stage import XmlStage
from nte.render.scenes import shapes
from nte.render.world.keyframes import read_animation
from nte.render.world.scene import Camera, Material, Scene, SceneObject
from nte.render.world.transforms import look_at, rotation, still
from nte.session import Session
from tests.render.shots import references_at

HEIGHT, WIDTH = 36, 60
COLOUR = np.array([0.5, 0.6, 0.2])
_RGB = '<rgb name="{}" value="0.5, 0.6, 0.2"/>'
PAINT = '<bsdf type="diffuse">' + _RGB.format("reflectance") + "</bsdf>"
HALF_METAL = (
    '<bsdf type="principled">'
    + _RGB.format("base_color")
    + '<float name="metallic" value="0.5"/><float name="roughness" value="0.6"/></bsdf>'
)
GOLD = '<bsdf type="roughconductor"><string name="material" value="Au"/></bsdf>'
# What lies on the floor, and the reflectance of its diffuse lobe where that is known: else the channels say the same.
FLOORS = {
    "paint": (PAINT, COLOUR),
    "both sides": (f'<bsdf type="twosided">{PAINT}</bsdf>', COLOUR),
    "half metal": (HALF_METAL, None),
    "plastic": ('<bsdf type="plastic">' + _RGB.format("diffuse_reflectance") + "</bsdf>", None),
    "rough plastic": ('<bsdf type="roughplastic">' + _RGB.format("diffuse_reflectance") + "</bsdf>", None),
    "dusty gold": (f'<bsdf type="blendbsdf"><float name="weight" value="0.3"/>{PAINT}{GOLD}</bsdf>', 0.7 * COLOUR),
    "gold": (GOLD, 0 * COLOUR),
    "glass": ('<bsdf type="dielectric"/>', 0 * COLOUR),
}


def dome(folder: Path, bsdf: str) -> XmlStage:
    """A floor below a lamp in the middle of a pale sphere, whose upper half sends the same light from everywhere."""
    (folder / "scene.xml").write_text(f"""<scene version="3.0.0">
      <sensor type="perspective"><float name="fov" value="30"/><transform name="to_world">
        <lookat origin="2, 3, -5" target="0, -1, 0" up="0, 1, 0"/></transform></sensor>
      <emitter type="point"><point name="position" x="0" y="0" z="0"/><rgb name="intensity" value="900, 700, 500"/>
      </emitter>
      <shape type="sphere" id="dome"><float name="radius" value="20"/><boolean name="flip_normals" value="true"/>
        <bsdf type="diffuse"><rgb name="reflectance" value="0.6, 0.7, 0.8"/></bsdf></shape>
      <shape type="rectangle" id="floor"><transform name="to_world"><rotate x="1" angle="-90"/>
        <scale value="6"/><translate y="-1"/></transform>{bsdf}</shape></scene>""")
    (folder / "still.yaml").write_text("xml: scene.xml")
    return XmlStage(read_animation(folder / "still.yaml"), WIDTH, HEIGHT, 3)


@pytest.mark.parametrize("name", FLOORS)
def test_indirect_light_is_what_arrives_times_the_diffuse_albedo(tmp_path: Path, name: str):
    bsdf, known = FLOORS[name]
    clean, runs = noisy(dome(tmp_path, bsdf), 0, [1, 2])
    assert (clean["instance"] == 2).all()
    reflectance = clean["diffuse_albedo"]
    if known is not None:
        np.testing.assert_allclose(reflectance, np.broadcast_to(known[:, None, None], reflectance.shape), rtol=1e-5)
    indirect, arriving, direction = (
        np.stack([run[channel] for run in runs]) for channel in ("indirect", "indirect_radiance", "indirect_direction")
    )
    if name in ("gold", "glass"):
        assert not indirect.any()
        return
    assert (reflectance > 0.02).all()
    taken = direction.any(1, keepdims=True)
    mean = (arriving * taken).sum((0, 2, 3)) / taken.sum()
    assert (mean > 0.1).all()
    np.testing.assert_allclose(indirect.mean((0, 2, 3)), reflectance.mean((1, 2)) * mean, rtol=0.02)


def test_the_metals_half_of_principled_is_not_diffuse(tmp_path: Path):
    """Burley's lobe is Lambert's within a twentieth; albedo, which guides a whole image, has all of the colour."""
    clean, _ = noisy(dome(tmp_path, HALF_METAL), 0, [1])
    half = COLOUR[:, None, None] / 2
    assert np.abs(clean["diffuse_albedo"] / half - 1).max() < 0.08
    np.testing.assert_allclose(clean["albedo"], np.broadcast_to(2 * half, clean["albedo"].shape), atol=0.01)


@pytest.mark.parametrize("turn", [0, 180])
def test_a_normal_map_leaves_the_geometric_normal_flat(tmp_path: Path, turn: int):
    """A slanted wall, from its front and its back."""
    tilted = '<texture type="bitmap" name="normalmap"><string name="filename" value="map.exr"/>'
    tilted += '<boolean name="raw" value="true"/></texture>'
    colours = {"R": 0.75, "G": 0.5, "B": 0.933}  # 30° to one side
    write_exr(tmp_path / "map.exr", {name: np.full((2, 2), value, np.float32) for name, value in colours.items()})
    (tmp_path / "scene.xml").write_text(f"""<scene version="3.0.0">
      <sensor type="perspective"><float name="fov" value="30"/><transform name="to_world">
        <lookat origin="0, 0, -5" target="0, 0, 0" up="0, 1, 0"/></transform></sensor><emitter type="constant"/>
      <shape type="rectangle" id="wall"><transform name="to_world"><rotate y="1" angle="{turn}"/>
        <rotate x="1" angle="30"/><scale value="9"/></transform>
        <bsdf type="twosided"><bsdf type="normalmap">{tilted}{PAINT}</bsdf></bsdf></shape></scene>""")
    (tmp_path / "still.yaml").write_text("xml: scene.xml")
    clean, _ = noisy(XmlStage(read_animation(tmp_path / "still.yaml"), WIDTH, HEIGHT, 2), 0, [1])
    flat = rotation((1, 0, 0), np.radians(30))[:3, :3] @ [0, 0, -1]
    expected = np.broadcast_to(flat[:, None, None], (3, HEIGHT, WIDTH))
    np.testing.assert_allclose(clean["geometric_normal"], expected, atol=1e-5)
    before_the_wall = (1 + np.cos(np.radians(30))) / 2  # of the lobe's light, the rest of which would go into it
    np.testing.assert_allclose(clean["diffuse_albedo"][:, 5, 5], before_the_wall * COLOUR, rtol=0.12)


def test_a_ball_of_a_family_has_the_normals_of_its_triangles():
    ball = SceneObject(shapes.sphere(), Material(np.full((1, 1, 3), 0.4, np.float32)), still(np.eye(4)))
    camera = Camera(still(look_at((1, 2, -5), (0, 0, 0))), 40.0)
    lamp = SceneObject(
        shapes.rectangle((-1, 5, -1), (2, 0, 0), (0, 0, 2)), ball.material, still(np.eye(4)), (5.0, 5.0, 5.0)
    )
    stage = MeshStage(Scene((ball, lamp), camera), WIDTH, HEIGHT, 2)
    clean, _ = noisy(stage, 0, [1])
    inside = clean["instance"][0] == 1
    corners = ball.mesh.positions[ball.mesh.faces].astype(float)
    facets = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(facets, axis=1, keepdims=True)
    facets = facets[length[:, 0] > 0] / length[length[:, 0] > 0]  # those at the poles have no area
    normal = clean["geometric_normal"][:, inside].T
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1, atol=1e-5)
    to_eye = np.array([1, 2, -5]) - clean["position"][:, inside].T
    assert ((normal * to_eye).sum(1) > 0).all()
    assert not clean["geometric_normal"][:, ~inside & ~(clean["albedo"].any(0))].any()
    # A pixel of 16 samples on one triangle has exactly that triangle's; on several, a mean of neighbours.
    assert (normal @ facets.T).max(1).min() > 0.97
    # Equal but where a sample at the rim sees a triangle whose interpolated normal faces away: no light leaves there.
    lost = (clean["albedo"] - clean["diffuse_albedo"]) / (0.4 / 16)  # in samples
    assert -1e-3 < lost.min() <= lost.max() < 1 + 1e-3
    assert (abs(lost) < 1e-3).mean() > 0.99


def test_both_are_rows_of_the_table_of_channels():
    for name, kind in (("diffuse_albedo", "reflectance"), ("geometric_normal", "direction")):
        row = CHANNELS[name]
        assert (row.kind, row.noisy, row.group) == (kind, False, "components")


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::nte.frames.bad.BadPixelWarning")
def test_trmv_gives_back_the_indirect_light_of_what_is_half_metal(tmp_path: Path):
    """From a red wall at one side and a grey one behind, lit by a lamp: few directions, one colour each, at rest."""
    walls = {"0.7, 0.15, 0.1": ("-90", "x='1.4' y='0' z='0'"), "0.5, 0.5, 0.6": ("180", "x='0' y='0' z='1.8'")}
    shapes_of = "".join(
        f'<shape type="rectangle"><transform name="to_world"><scale value="1.6"/><rotate y="1" angle="{angle}"/>'
        f'<translate {place}/></transform><bsdf type="diffuse"><rgb name="reflectance" value="{colour}"/></bsdf>'
        "</shape>"
        for colour, (angle, place) in walls.items()
    )
    (tmp_path / "scene.xml").write_text(f"""<scene version="3.0.0">
      <sensor type="perspective"><float name="fov" value="26"/><transform name="to_world">
        <lookat origin="-0.5, 2, -3" target="0.1, -1, 0.1" up="0, 1, 0"/></transform></sensor>
      <emitter type="point"><point name="position" x="-0.2" y="0.3" z="-0.2"/><rgb name="intensity" value="9, 8, 7"/>
      </emitter>{shapes_of}
      <shape type="rectangle" id="floor"><transform name="to_world"><rotate x="1" angle="-90"/>
        <scale value="6"/><translate y="-1"/></transform>{HALF_METAL}</shape></scene>""")
    (tmp_path / "still.yaml").write_text("xml: scene.xml")
    stage = XmlStage(read_animation(tmp_path / "still.yaml"), WIDTH, HEIGHT, 3)
    clean, samples = noisy(stage, 0, range(12))
    floor = clean["instance"][0] == 3
    assert floor.mean() > 0.9
    session, found = Session(Trmv(TrmvOptions("indirect"))), []
    for index, sample in enumerate(samples):
        channels = {name: values[None] for name, values in (clean | sample).items()}
        found.append(np.asarray(session.denoise(Frame(channels, index)))[0])
    expected = references_at(stage, 0, 512, (1, 2))["reference_indirect"][:, floor].mean(1)
    light = expected / COLOUR
    assert light[0] > 1.3 * light[2]  # the red wall tells
    np.testing.assert_allclose(np.mean(found[4:], axis=0)[:, floor].mean(1), expected, rtol=0.02)
