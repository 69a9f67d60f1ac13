"""What much data costs, from the unit costs of this machine: python -m benchmarks.scale [options]

Measures the core seconds that rendering, reading and cutting crops take for a pixel, and what it takes on the disk, on
a small clip; and multiplies them for a data set and for the devices of a training. Only the unit costs are measured.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks.command import count, make_parser, run
from benchmarks.record import record
from nte.cli.parsing import parse_size
from nte.frames.channels import width_of
from nte.frames.clip import Clip
from nte.render.recipes.clips import render_recipe
from nte.training.tiles import ClipStore

FRAMES = 4
SMALL = 256, 144
READ = ("color", "albedo", "normal", "depth", "motion", "previous_forward_motion", "reference")
RECIPE = """
name: scale
train:
  - {{scene: {scene}, clips: 1, width: {width}, height: {height}, frames: {frames}, reference_spp: {spp},
     components: {lights}}}
"""


@dataclass(frozen=True)
class Costs:
    """The costs of a frame's pixel. Times are core seconds."""

    sample: float  # of rendering a sample
    disk: float  # bytes of the frame's file
    read: float  # of reading the channels that a training uses
    crop: float  # of cutting a pixel from decoded clips
    memory: float  # bytes of a decoded pixel


def measure(scene: str, spp: int, components: bool) -> Costs:
    """Measure on a clip of 256×144; the first rendering, which compiles kernels, does not count."""
    with TemporaryDirectory() as folder:
        width, height = SMALL
        lights = str(components).lower()
        recipe = Path(folder, "recipe.yaml")
        recipe.write_text(RECIPE.format(scene=scene, width=width, height=height, frames=FRAMES, spp=spp, lights=lights))
        render_recipe(recipe, Path(folder, "first"), progress=False)
        rendering = core_seconds(lambda: render_recipe(recipe, Path(folder, "data"), progress=False))
        clip = Clip(Path(folder, "data", "train", f"{scene}_000"))
        disk = sum(path.stat().st_size for path in clip.folder.rglob("*.exr"))
        reading = core_seconds(lambda: [clip.frame(index, READ) for index in range(FRAMES)])
        tiles = ClipStore([clip], READ).get(0, 0)
        crop = slice(0, 128)
        cutting = core_seconds(lambda: [tiles.crop(slice(0, FRAMES), crop, crop) for _ in range(50)])
    pixels = FRAMES * width * height
    return Costs(
        rendering / pixels / (spp + 1), disk / pixels, reading / pixels, cutting / (50 * FRAMES * 128**2),
        4.0 * sum(map(width_of, READ)),
    )  # fmt: skip


def core_seconds(work: Callable[[], object]) -> float:
    """The core seconds that this process spends on some work."""
    start = time.process_time()
    work()
    return time.process_time() - start


def main(arguments: Sequence[str]) -> None:
    """Run the command."""
    parser = make_parser(__doc__)
    parser.add_argument("--scene", default="rooms", help="a family without parameters")
    parser.add_argument("--components", action="store_true", help="with light components and their vectors")
    parser.add_argument("--spp", type=count, default=128, help="of the references; an even number")
    parser.add_argument("--clips", type=count, default=100_000)
    parser.add_argument("--frames", type=count, default=10, help="of each clip")
    parser.add_argument("--size", type=parse_size, default=(1080, 1920), metavar="WIDTHxHEIGHT")
    parser.add_argument("--devices", type=count, default=64)
    parser.add_argument(
        "--rate", type=float, default=20.0, help="crops of 256×256 and 9 frames a second on each device"
    )
    given = parser.parse_args(arguments)
    costs = measure(given.scene, given.spp, given.components)
    pixels = float(given.clips * given.frames * np.prod(given.size))
    demand = given.devices * given.rate * 9 * 256**2  # pixels a second
    lights = " with components" if given.components else ""
    print(f"{given.scene}{lights}, on one core of this machine:")
    print(f"  rendering  {1e-6 / costs.sample:7.2f} million samples a second")
    print(f"  reading    {1e-6 / costs.read:7.2f} million pixels a second")
    print(f"  crops      {1e-6 / costs.crop:7.2f} million pixels a second")
    print(f"  disk       {costs.disk:7.1f} bytes a pixel")
    print(f"  decoded    {costs.memory:7.1f} bytes a pixel")
    size = f"{given.size[1]}x{given.size[0]}"
    print(f"{given.clips} clips of {given.frames} frames of {size}, {given.spp} spp, would take:")
    print(f"  rendering  {pixels * (given.spp + 1) * costs.sample / 3600:12,.0f} core hours")
    print(f"  disk       {1e-12 * pixels * costs.disk:12,.1f} TB")
    print(f"  decoded    {1e-12 * pixels * costs.memory:12,.1f} TB")
    print(f"{given.devices} devices with {given.rate:g} crops of 256x256 and 9 frames a second each would take:")
    whole = demand * float(np.prod(given.size)) / 256**2
    for name, cores, bytes_ in (
        ("from decoded clips", demand * costs.crop, demand * costs.memory),
        ("from whole frames, read anew", whole * costs.read, whole * costs.disk),
    ):
        print(f"  {name:28} {cores:8,.1f} cores, {1e-9 * bytes_:8,.1f} GB a second")
    record("scale", {"rendering": costs.sample, "reading": costs.read, "crops": costs.crop}, "core s a pixel")


if __name__ == "__main__":
    run(main)
