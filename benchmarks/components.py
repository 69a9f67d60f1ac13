"""Cost of light components relative to a bare mi.render: python -m benchmarks.components [SIZE …]

Everything runs in one process, with warm kernels. For the short tasks the best of several repetitions counts, because
other work on the machine only adds time. For the long tasks the median of ratios to the preceding task counts.
"""

import time
from collections.abc import Callable, Sequence

import numpy as np

from benchmarks.command import count, make_parser, run
from benchmarks.record import record
from nte.render.components.frame import noisy, references
from nte.render.engine.backend import load_mitsuba
from nte.render.engine.mesh_stage import MeshStage
from nte.render.passes.radiance import launches, radiance
from nte.render.scenes.families import FAMILIES
from nte.render.world.seeds import derive_generator

SPP, TIMES = 128, 7


def measure(size: int) -> int:
    """Print the ratios of one size. Return 0 if all are within what the project promises, else 1."""
    mi = load_mitsuba()
    stage = MeshStage(FAMILIES["rooms"](derive_generator("benchmark")), size, size, 4)

    def bare(spp: int) -> None:
        with stage.at(0) as moment:
            for number, count in enumerate(launches(spp, size * size)):
                mi.render(moment.scenery.mi_scene, spp=count, seed=number).numpy()

    def frame(index: int) -> None:
        noisy(stage, index, [index])

    def colour_reference() -> None:
        with stage.at(0) as moment:
            radiance(moment, SPP // 2, 1)
            radiance(moment, SPP // 2, 2)

    def all_references() -> None:
        with stage.at(0) as moment:
            references(moment, SPP, (1, 2))

    tasks: dict[str, Callable[[], object]] = {
        "bare 1 spp": lambda: bare(1),
        "1 spp frame, all channels": lambda: frame(len(spent["bare 1 spp"])),
        f"bare {SPP} spp": lambda: (bare(SPP // 2), bare(SPP // 2)),
        "colour reference": colour_reference,
        "with component references": all_references,
    }
    spent: dict[str, list[float]] = {name: [] for name in tasks}
    for _ in range(1 + TIMES):
        for name, task in tasks.items():
            start = time.perf_counter()
            task()
            spent[name].append(time.perf_counter() - start)
    one, frame_time, many, colour, separated = (np.array(times[1:]) for times in spent.values())
    best = one.min()
    checks = [
        ("1 spp frame with everything", frame_time.min(), 2.5 * best + 0.3, f"2.5 × {best:.3f} + 0.3 s"),
        ("colour reference", np.median(colour / many), 1.1, f"× bare {SPP} spp, {many.min():.2f} s"),
        ("with component references", np.median(separated / many), 2.0, "× the same"),
    ]
    record("components", {f"{name}, {size}×{size}": float(value) for name, value, *_ in checks[1:]}, "× bare")
    record("components", {f"{checks[0][0]}, {size}×{size}": float(checks[0][1])}, "s")
    print(f"{size}×{size}, kernels warm, {TIMES} repetitions")
    for name, value, limit, meaning in checks:
        print(f"{'ok  ' if value <= limit else 'SLOW'} {name:28} {value:.3f}, at most {limit:.3f} = {meaning}")
    return int(any(value > limit for _, value, limit, _ in checks))


def main(arguments: Sequence[str]) -> int:
    """Measure frames of every size; return 1 if something does not hold."""
    parser = make_parser(__doc__)
    parser.add_argument("sizes", nargs="*", type=count, default=[128, 256], metavar="SIZE", help="pixels (128 256)")
    return max([measure(size) for size in parser.parse_args(arguments).sizes])


if __name__ == "__main__":
    run(main)
