"""A hall of fluted columns over a glossy floor, seen by a fast camera: reflections that move unlike the floor."""

from dataclasses import dataclass

import numpy as np

from nte.render.scenes import kit, shapes
from nte.render.scenes.family import Dice, between
from nte.render.scenes.patterns import bricks, checker, marble, noise
from nte.render.scenes.solids import block, merged, placed
from nte.render.world.scene import Camera, Mesh, Scene, SceneObject
from nte.render.world.transforms import Floats, still, translation

_PAIRS = 5  # of columns
_STEP, _AISLE, _HALF, _HEIGHT = 2.4, 2.0, 4.2, 4.6  # between columns; half widths of the nave and the hall; height


@dataclass
class Parameters:
    """speed: of the camera; at 1 the image moves by some 4 to 8 pixels a frame at 128. roughness: of the floor."""

    speed: float = between(1.0, 0.0, 4.0)
    roughness: float = between(0.15, 0.05, 0.6)


def make_temple(dice: Dice, parameters: Parameters) -> Scene:
    """Make a nave between two rows of columns, with braziers behind them, skylights above and a statue at the end."""
    objects = [*_hall(dice, parameters), *_columns(dice), *_lights(dice)]
    hue = dice.uniform()
    statue = merged([block((1.0, 0.8, 1.0)), placed(shapes.vase(dice), translation((0, 1.6, 0)), 0.8)])
    gold = kit.plain(0.09 + 0.05 * hue, 0.55, 0.9)
    objects.append(kit.thing(statue, gold, kit.standing(0, _PAIRS * _STEP), "metal", 0.3))
    return Scene(tuple(objects), _camera(dice, parameters.speed))


def _hall(dice: Dice, parameters: Parameters) -> list[SceneObject]:
    stone = kit.shades(dice.apart(0.05, 0.15), 0.3, (0.85, 0.65, 0.45))
    length = _PAIRS * _STEP + 3
    tiles = kit.textured(dice, kit.shades(dice.uniform(), 0.4, (0.7, 0.4, 0.15)), checker, marble)
    end = kit.textured(dice, kit.shades(0.03, 0.5), bricks, marble)
    mesh = shapes.rectangle((-_HALF, 0, length), (2 * _HALF, 0, 0), (0, 0, -length - 3), 4.0)
    ceiling = shapes.rectangle((-_HALF, _HEIGHT + 0.4, -3), (2 * _HALF, 0, 0), (0, 0, length + 3), 3.0)
    return [
        kit.thing(mesh, tiles, still(), "glossy", parameters.roughness),
        kit.thing(ceiling, kit.textured(dice, stone, checker, bricks), still()),
        kit.wall((_HALF, length), (-_HALF, length), _HEIGHT + 1, end),
        kit.wall((-_HALF, length), (-_HALF, -3), _HEIGHT + 1, kit.textured(dice, stone, bricks, noise)),
        kit.wall((_HALF, -3), (_HALF, length), _HEIGHT + 1, kit.textured(dice, stone, bricks, noise)),
        kit.wall((-_HALF, -3), (_HALF, -3), _HEIGHT + 1, kit.textured(dice, stone, bricks)),
    ]


def _columns(dice: Dice) -> list[SceneObject]:
    color = kit.textured(dice, kit.shades(0.1, 0.2, (0.9, 0.75, 0.6)), marble, noise)
    mesh = fluted_column(_HEIGHT, dice.uniform(0.28, 0.36))
    return [
        kit.thing(mesh, color, kit.standing(side * _AISLE, _STEP * (number + 0.7), float(number)))
        for number in range(_PAIRS)
        for side in (-1, 1)
    ]


def fluted_column(height: float, radius: float, flutes: int = 12) -> Mesh:
    """Make a shaft with grooves that swells a little, between a base and a capital."""

    def shaft(u: Floats, v: Floats) -> Floats:
        angle = -2 * np.pi * u
        r = radius * (1 - 0.12 * v) * (1 - 0.07 * np.abs(np.sin(flutes / 2 * angle)))
        return np.stack([r * np.cos(angle), height * (0.05 + 0.89 * v), r * np.sin(angle)], 1)

    side = 2.6 * radius
    foot = block((side, 0.05 * height, side))
    capital = block((side, 0.06 * height, side), (0, 0.94 * height, 0))
    return merged([placed(shapes.parametric(shaft, 96, 8), np.eye(4), texture=2.0), foot, capital])


def _lights(dice: Dice) -> list[SceneObject]:
    """Skylights along the nave, and glowing braziers in the aisles, half hidden by the columns."""
    lights = [
        kit.panel(1.4, 1.8, 26.0, still(translation((0, _HEIGHT + 0.3, z)) @ kit.DOWNWARDS), (1.0, 0.93, 0.8))
        for z in (2.0, 6.5, 11.0)
    ]
    for side in (-1, 1):
        z = _STEP * (dice.integers(1, 4) + 0.2)
        lights.append(kit.bulb(0.22, 4.5, kit.standing(side * 2.9, z, y=1.4), (1.0, 0.55, 0.22)))
    return lights


def _camera(dice: Dice, speed: float) -> Camera:
    """A camera that runs along the nave and swings its gaze from side to side."""
    way, swing = speed * dice.uniform(0.05, 0.12), speed * dice.apart(0.2, 0.5) * dice.choice([-1, 1])
    start = (dice.uniform(-0.8, 0.8), dice.uniform(1.3, 1.9), -1.6)
    eye = kit.drifting(start, (0.3 * way * dice.choice([-1, 1]), 0, way))
    gaze = kit.drifting((-6 * swing, dice.uniform(0.6, 1.0), 7), (swing, 0, way))
    return kit.camera(eye, gaze, 62)
