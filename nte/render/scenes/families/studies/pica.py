"""Toys on a floor, and boxes that pass in front of bright and dark background, also at the image's border."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from nte.render.scenes import kit, shapes
from nte.render.scenes.family import Dice, between, switch
from nte.render.scenes.patterns import checker, dots, stripes
from nte.render.scenes.solids import block, cushion, merged, placed
from nte.render.world.scene import Mesh, Scene, SceneObject, Surface
from nte.render.world.transforms import translation

_BANDS = 7  # of the wall, dark and bright in turn
_TOYS = 14


@dataclass
class Parameters:
    """boxes: how many pass. moving_camera: whether the camera sways as well."""

    boxes: int = between(3, 1, 6)
    moving_camera: bool = switch(False)


def make_pica(dice: Dice, parameters: Parameters) -> Scene:
    """Make a floor, a banded wall, standing toys, and boxes that pass between them and the camera."""
    floor = kit.textured(dice, kit.shades(dice.uniform(), 0.25, (0.8, 0.65, 0.45)), checker, dots)
    objects = [kit.ground(16, 14, floor, texture_size=3.5), *_wall(dice), *_toys(dice)]
    objects += [_box(dice, number) for number in range(parameters.boxes)]
    overhead = kit.aimed(kit.fixed((dice.uniform(-2.5, 2.5), 5.5, -2.0)), (0, 0, 2.5))
    objects.append(kit.panel(2.5, 2.5, 160.0, overhead))
    sway = dice.uniform(0.3, 0.6) * dice.choice([-1, 1]) * parameters.moving_camera
    eye = kit.swaying((0, 2.0, -4.6), (sway, 0, 0), 0.2)
    return Scene(tuple(objects), kit.camera(eye, kit.fixed((0, 0.6, 1.5)), 44))


def _wall(dice: Dice) -> list[SceneObject]:
    """Upright bands, so that what is uncovered is very bright in some places and very dark in others."""
    width, hue = 12 / _BANDS, dice.apart(0, 1)
    bands = []
    for i in range(_BANDS):
        values = ((0.1, 0.06, 0.03), (0.9, 0.8, 0.65))[i % 2]
        color = kit.textured(dice, kit.shades(hue + 0.5 * (i % 2), 0.4, values), stripes, dots)
        left = 6 - i * width
        bands.append(kit.wall((left, 4.5), (left - width, 4.5), 5, color, texture_size=2.5))
    return bands


def _toys(dice: Dice) -> list[SceneObject]:
    """Objects on a loose grid, each in a loud colour of its own."""
    places = [(x, z) for z in (0.2, 1.6, 3.0) for x in np.linspace(-2.4, 2.4, 5)]
    toys = []
    for i in dice.permutation(len(places))[:_TOYS]:
        x, z = np.array(places[i]) + dice.uniform(-0.25, 0.25, 2)
        mesh = placed(_TOY_SHAPES[dice.integers(len(_TOY_SHAPES))](dice), np.eye(4), dice.uniform(0.9, 1.4))
        colours = np.concatenate([kit.shades(dice.uniform(), 0.75, (0.8, 0.6, 0.4))[:2], [[0.85, 0.8, 0.7]]])
        surface: Surface = "glossy" if dice.uniform() < 0.3 else "diffuse"
        track = kit.standing(float(x), float(z), dice.uniform(0, 6))
        toys.append(kit.thing(mesh, kit.textured(dice, colours), track, surface, 0.35 if surface == "glossy" else 1.0))
    return toys


def _box(dice: Dice, number: int) -> SceneObject:
    """A box that flies across, some 3 to 10 pixels a frame at 128, and leaves the image at one side or the other."""
    size = dice.uniform(0.45, 0.8)
    mesh = cushion((size, size * dice.uniform(0.8, 1.3), size), 0.06, texture_size=1.2)
    z = (-1.4, 0.9, 2.3)[number % 3]
    reach = 1.1 * (z + 4.6) * np.tan(np.radians(24)) + 0.3
    start = np.array([reach * dice.uniform(-0.95, 0.0), (0.35, 0.9, 1.5)[number % 3], z])
    speed = dice.apart(0.12, 0.3) * (1 + 0.15 * z)
    direction = -1.0 if number % 2 else 1.0
    color = kit.textured(dice, kit.shades(dice.uniform(), 0.65, (0.9, 0.6, 0.3)))
    path = kit.drifting(start * (direction, 1, 1), (direction * speed, 0, 0))
    return kit.thing(mesh, color, kit.following(path))


def _pile(dice: Dice) -> Mesh:
    """Three stacked blocks."""
    turns = dice.uniform(-0.1, 0.1, 3)
    return merged([block((0.42 - 0.08 * i, 0.3, 0.36), (turns[i], 0.3 * i, 0), 1.0) for i in range(3)])


def _rings(dice: Dice) -> Mesh:
    """Three stacked rings, the largest at the bottom."""
    return merged([placed(shapes.torus(dice), translation((0, 0.1 + 0.18 * i, 0)), 0.45 - 0.1 * i) for i in range(3)])


_TOY_SHAPES: tuple[Callable[[Dice], Mesh], ...] = (
    _pile,
    lambda dice: cushion((0.55, 0.4, 0.4), 0.08),
    lambda dice: placed(shapes.sphere(), translation((0, 0.32, 0)), 0.32),
    lambda dice: placed(shapes.cylinder(), translation((0, 0.4, 0)), 0.4),
    lambda dice: placed(shapes.vase(dice), translation((0, 0.5, 0)), 0.5),
    _rings,
    lambda dice: placed(shapes.knot(dice), translation((0, 0.35, 0)), 0.45),
)
