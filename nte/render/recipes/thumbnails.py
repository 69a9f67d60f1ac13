"""Strips of small pictures of the scenes in recipes: python -m nte.render.recipes.thumbnails RECIPE… --out DIR."""

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from PIL import Image

from nte.color import display
from nte.errors import NteError
from nte.render.passes.radiance import radiance
from nte.render.recipes.recipe import ClipPlan, Group, make_stage, plan, read_recipe, scene_name
from nte.render.world.scene import Pixels

PICTURES = 4  # pictures in a strip, spread evenly over the clip
COLOURS = 255  # a palette keeps a strip under 40 kB, however noisy it is


def thumbnails(recipe: Path, out: Path, size: int = 96, spp: int = 144) -> list[Path]:
    """Write a PNG for the first training clip of every scene and set of parameters in the recipe; return the paths.

    size: pixels of one picture. spp: samples per pixel.
    """
    first: dict[str, ClipPlan] = {}
    for unit in plan(read_recipe(recipe), recipe.parent):
        if unit.split == "train":
            first.setdefault(strip_name(unit.group), unit)
    out.mkdir(parents=True, exist_ok=True)
    paths = []
    for name, unit in first.items():
        path = out / f"{name}.png"
        image = Image.fromarray(strip(unit, size, spp))
        image.quantize(COLOURS, dither=Image.Dither.NONE).save(path, optimize=True)
        paths.append(path)
    return paths


def strip_name(group: Group) -> str:
    """Return the name of the file that shows a group of clips: fence, or fence-lights-3."""
    return "-".join([scene_name(group), *(f"{key}-{value}".lower() for key, value in group.parameters.items())])


def strip(unit: ClipPlan, size: int, spp: int) -> Pixels:
    """Render frames of a clip side by side, (size, PICTURES · size, 3) uint8, as the display transform shows them."""
    group = replace(unit.group, width=size, height=size)
    stage = make_stage(replace(unit, group=group))
    frames = []
    for time in np.linspace(0, unit.group.frames - 1, PICTURES).round():
        with stage.at(time) as moment:
            frames.append(radiance(moment, spp, seed=int(time)))
    image = torch.from_numpy(np.concatenate(frames, axis=2))[None]
    # Exposure from the geometric mean, so that a lamp in view does not darken the rest.
    exposure = 0.18 / torch.exp(torch.log(image.mean(1).clamp(min=1e-4)).mean())
    shown = display(image, exposure[None] * 1.5)[0].permute(1, 2, 0)
    return np.asarray((shown * 255).round().byte().numpy())


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(description="Strips of small pictures of the scenes in recipes.")
    parser.add_argument("recipes", nargs="+", type=Path)
    parser.add_argument("--out", type=Path, default=Path("datasets/thumbnails"))
    parser.add_argument("--size", type=int, default=96, help="pixels of one picture")
    parser.add_argument("--spp", type=int, default=144)
    given = parser.parse_args(arguments)
    try:
        for recipe in given.recipes:
            for path in thumbnails(recipe, given.out, given.size, given.spp):
                print(path)
    except NteError as error:
        parser.exit(2, f"{error}\n")


if __name__ == "__main__":
    main()
