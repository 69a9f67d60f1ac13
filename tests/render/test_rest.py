"""Places on somebody else's shapes: what keyframes carry to another time is what a ray meets there."""

import numpy as np
import pytest
import trimesh

from nte.render.engine.xml.stage import XmlStage
from nte.render.passes.hits import curvatures_at, normals_at, points_at
from nte.render.passes.projection import pixel_positions
from nte.render.passes.rays import trace_centres, trace_film
from nte.render.world.keyframes import read_animation

SHAPES = """<scene version="3.0.0">
<sensor type="perspective"><float name="fov" value="40"/><transform name="to_world">
  <lookat origin="0, 1, -6" target="0, 0, 0" up="0, 1, 0"/></transform></sensor>
<shape type="ply" id="mesh"><string name="filename" value="ball.ply"/>
  <transform name="to_world"><scale value=".8"/><translate x="-1"/></transform></shape>
<shape type="shapegroup" id="group"><shape type="ply"><string name="filename" value="ball.ply"/>
  <transform name="to_world"><scale value=".6"/></transform></shape></shape>
<shape type="instance" id="mirrored"><ref id="group"/>
  <transform name="to_world"><scale x="-1" y="1.4" z="1"/><translate x="1"/></transform></shape>
<shape type="sphere" id="sphere"><point name="center" x="0" y="-1.2" z="0"/><float name="radius" value=".6"/></shape>
<shape type="cylinder" id="cylinder"><point name="p0" x="-.6" y="1.2" z="0"/><point name="p1" x=".6" y="1.3" z="0"/>
  <float name="radius" value=".4"/></shape>
<shape type="cube" id="cube"><transform name="to_world"><scale value=".3"/><translate x="1.6" y="1.2"/></transform>
  </shape>
<emitter type="constant"/></scene>"""
MOVES = """xml: shapes.xml
objects:
  mesh: [{frame: 0}, {frame: 8, scale: [1.2, 1.2, 1.2], rotate: [20, 30, 10], pivot: [-1, 0, 0]}]
  mirrored: [{frame: 0}, {frame: 8, scale: [1.2, 0.9, 1], rotate: [20, 30, 10], pivot: [1, 0, 0]}]
  sphere: [{frame: 0}, {frame: 8, translate: [0.3, 0.1, 0]}]
  cylinder: [{frame: 0}, {frame: 8, rotate: [0, 40, 20], pivot: [0, 1.2, 0]}]
  cube: [{frame: 0}, {frame: 8, rotate: [30, 40, 20], pivot: [1.6, 1.2, 0]}]
"""


@pytest.fixture(scope="module")
def stage(tmp_path_factory: pytest.TempPathFactory) -> XmlStage:
    folder = tmp_path_factory.mktemp("rest")
    ball = trimesh.creation.uv_sphere(count=[40, 80])
    ball = trimesh.Trimesh(ball.vertices, ball.faces, vertex_normals=ball.vertices, process=False)
    ball.export(folder / "ball.ply", vertex_normal=True)
    (folder / "shapes.xml").write_text(SHAPES)
    (folder / "moves.yaml").write_text(MOVES)
    return XmlStage(read_animation(folder / "moves.yaml"), 64, 64, 3)


@pytest.mark.parametrize(
    ("name", "curvature", "error"),
    [
        ("mesh", 1 / (0.8 * 1.1), 1e-3),
        # Scaled unevenly it has other normals between its vertices than the carried ones, as Mitsuba makes those of the
        # vertices unit vectors before it interpolates.
        ("mirrored", None, 0.1),
        ("sphere", 1 / 0.6, 1e-4),
        ("cylinder", 1 / 0.4, 1e-3),
        ("cube", 0, 0),
    ],
)
def test_what_is_carried_is_what_is_met(stage: XmlStage, name: str, curvature: float | None, error: float):
    with stage.at(2) as moment:
        hits = trace_centres(moment)
    number = [obj.name for obj in stage.objects].index(name) + 1
    hits = hits.of(hits.instance == number)
    point, normal, bend = points_at(stage, hits, 4), normals_at(stage, hits, 4), curvatures_at(stage, hits, 4)
    with stage.at(4) as moment:
        seen = trace_film(moment, pixel_positions(stage, point, 4))
    same = (seen.hits.instance == number) & (np.linalg.norm(seen.point - point, axis=1) < 2e-3)  # not turned away
    assert same.sum() > 30
    assert same.mean() > 0.9
    np.testing.assert_allclose(normal[same], seen.normal[same], atol=1e-3)
    np.testing.assert_allclose(normals_at(stage, seen.hits, 4)[same], seen.normal[same], atol=1e-6)
    there = curvatures_at(stage, seen.hits, 4)[same]
    assert np.median(np.abs(there - bend[same]).max((1, 2))) <= error
    # Of the two directions, the one that bends more: of a ball, and about the cylinder's axis.
    most = np.abs(np.linalg.eigvalsh((there + there.transpose(0, 2, 1)) / 2)).max(1)
    if curvature is not None:
        np.testing.assert_allclose(np.median(most), curvature, rtol=0.01)
