"""Cost of moving one part of a large scene of one's own: python -m benchmarks.own_scene [PARTS] [LEVELS]

The scene has PARTS meshes (400), each a ball of 20·4^LEVELS triangles (LEVELS is 3), and is rendered at 160×120 and
1 spp. Frames of the scene with one moving part and frames of the same scene at rest alternate in one run; the best of
several counts. Returns 1 if a frame costs more than 1.3 times a frame at rest plus one rebuild of Mitsuba's
acceleration structure.
"""

import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import trimesh

from benchmarks.command import count, make_parser, run
from benchmarks.record import record
from nte.render.components.frame import noisy
from nte.render.engine.xml.stage import XmlStage
from nte.render.passes.gbuffer import guides
from nte.render.passes.radiance import radiance
from nte.render.world.keyframes import read_animation

WIDTH, HEIGHT, TIMES = 160, 120, 3


def write_scene(folder: Path, parts: int, levels: int) -> None:
    """Write a field of balls below a lamp and a sky, and two animations: at rest, and with one moving ball."""
    trimesh.creation.icosphere(levels, 0.4).export(folder / "ball.ply")
    shapes = [
        f'<shape type="ply" id="part_{i}"><string name="filename" value="ball.ply"/><transform name="to_world">'
        f'<translate x="{i % 20 - 10}" z="{i // 20}"/></transform><ref id="paint_{i % 8}"/></shape>'
        for i in range(parts)
    ]
    paints = [
        f'<bsdf type="diffuse" id="paint_{i}"><rgb name="reflectance" value="0.{1 + i}, 0.5, 0.4"/></bsdf>'
        for i in range(8)
    ]
    (folder / "scene.xml").write_text(
        '<scene version="3.0.0"><sensor type="perspective"><float name="fov" value="50"/><transform name="to_world">'
        '<lookat origin="0, 9, -9" target="0, 0, 6" up="0, 1, 0"/></transform></sensor><emitter type="constant"><rgb '
        'name="radiance" value="0.2"/></emitter><shape type="rectangle" id="lamp"><transform name="to_world"><rotate '
        'x="1" angle="90"/><translate y="8"/></transform><emitter type="area"><rgb name="radiance" value="20"/>'
        f"</emitter></shape>{''.join([*paints, *shapes])}</scene>"
    )
    (folder / "still.yaml").write_text("xml: scene.xml")
    (folder / "moving.yaml").write_text(
        f"xml: scene.xml\nobjects: {{part_{parts // 3}: [{{frame: 0}}, {{frame: 99, translate: [0, 9, 3]}}]}}"
    )


def spent(task: Callable[[], object]) -> float:
    """Return the seconds that the task takes."""
    start = time.perf_counter()
    task()
    return time.perf_counter() - start


def put(stage: XmlStage, index: float) -> None:
    """Move the scene to a time without rendering anything."""
    with stage.at(index):
        pass


def colour(stage: XmlStage, index: int) -> None:
    """Render a frame without light components."""
    with stage.at(index) as moment:
        guides(moment)
        radiance(moment, 1, index)


def measure(parts: int, levels: int) -> int:
    """Print the table. Return 0 if all is within what the project promises, else 1."""
    stages: dict[str, XmlStage] = {}
    frames: dict[str, Callable[[XmlStage, int], object]] = {
        "colour": colour,
        "components": lambda stage, index: noisy(stage, index, [index]),
    }
    with tempfile.TemporaryDirectory() as name:
        write_scene(Path(name), parts, levels)
        for kind in ("still", "moving"):
            animation = read_animation(Path(name) / f"{kind}.yaml")
            loading = spent(lambda: stages.update({kind: XmlStage(animation, WIDTH, HEIGHT, 4)}))  # noqa: B023
            first = spent(lambda: put(stages[kind], 0))  # noqa: B023
            print(f"{kind}: loaded in {loading:.2f} s, first time {first:.2f} s")
    print(f"{parts} parts, {parts * 20 * 4**levels} triangles, {WIDTH}×{HEIGHT}, 1 spp, best of {TIMES}, seconds")
    slow = 0
    for what, render in frames.items():
        best = {"still": 1e9, "moving": 1e9, "rebuild": 1e9}
        for index in range(1, 2 + TIMES):
            for kind, stage in stages.items():
                took = spent(lambda: render(stage, index))  # noqa: B023
                if index > 1:  # kernels are warm
                    best[kind] = min(best[kind], took)
            best["rebuild"] = min(best["rebuild"], spent(lambda: put(stages["moving"], 50 + index)))  # noqa: B023
            put(stages["moving"], index)
        limit = 1.3 * best["still"] + best["rebuild"]
        slow |= best["moving"] > limit
        record("own_scene", {f"{what}, {kind}, {parts} parts": took for kind, took in best.items()}, "s")
        print(
            f"{'SLOW' if best['moving'] > limit else 'ok  '} {what:11} moving {best['moving']:.3f}, at rest "
            f"{best['still']:.3f}, one rebuild {best['rebuild']:.3f}: at most {limit:.3f}"
        )
    return int(slow)


def main(arguments: Sequence[str]) -> int:
    """Measure a scene of so many parts."""
    parser = make_parser(__doc__)
    parser.add_argument("parts", nargs="?", type=count, default=400, metavar="PARTS")
    parser.add_argument("levels", nargs="?", type=count, default=3, metavar="LEVELS")
    given = parser.parse_args(arguments)
    return measure(given.parts, given.levels)


if __name__ == "__main__":
    run(main)
