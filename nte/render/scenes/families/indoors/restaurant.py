"""Round tables on a glossy floor, with metal vases and globes that reflect the room, seen by a fast camera."""

from dataclasses import dataclass

import numpy as np

from nte.render.scenes import furniture, kit, shapes
from nte.render.scenes.family import Dice, between
from nte.render.scenes.patterns import bricks, checker, marble, stripes
from nte.render.scenes.solids import merged, placed
from nte.render.world.scene import Camera, Pixels, Scene, SceneObject
from nte.render.world.transforms import rotation, still, translation

_HALF, _DEPTH, _HEIGHT = 3.2, 7.0, 3.0  # of the room
_TABLES = ((-1.3, 2.0), (1.2, 2.6), (-0.9, 4.4), (1.7, 5.0))  # x, z


@dataclass
class Parameters:
    """speed: of the camera; at 1 the image moves by some 3 to 8 px a frame at 128. roughness: of floor and tables."""

    speed: float = between(1.0, 0.0, 4.0)
    roughness: float = between(0.18, 0.05, 0.6)


def make_restaurant(dice: Dice, parameters: Parameters) -> Scene:
    """Make a room with four laid tables, a hanging lamp over each, and windows on one side."""
    objects = _room(dice, parameters)
    seat = kit.textured(dice, kit.shades(dice.uniform(0.0, 0.1), 0.6), marble, stripes)
    top = kit.textured(dice, kit.shades(dice.apart(0.0, 1.0), 0.5, (0.7, 0.5, 0.3)), marble)
    for number, (x, z) in enumerate(_TABLES):
        objects += _table(dice, x + dice.uniform(-0.2, 0.2), z + dice.uniform(-0.2, 0.2), number, top, seat, parameters)
    return Scene(tuple(objects), _camera(dice, parameters.speed))


def _room(dice: Dice, parameters: Parameters) -> list[SceneObject]:
    tiles = kit.textured(dice, kit.shades(dice.uniform(), 0.3, (0.8, 0.5, 0.12)), checker)
    paper = kit.shades(dice.uniform(), 0.45, (0.85, 0.65, 0.5))
    floor = kit.ground(2 * _HALF, 2 * _DEPTH, tiles, "glossy", parameters.roughness, texture_size=3.2)
    lid = shapes.rectangle((-_HALF, _HEIGHT, -2), (2 * _HALF, 0, 0), (0, 0, _DEPTH + 2))
    windows = [translation((_HALF - 0.05, 1.7, z)) @ rotation(kit.UP, -np.pi / 2) for z in (1.6, 4.4)]
    return [
        floor,
        kit.thing(lid, kit.plain(0.1, 0.1, 0.8), still()),
        kit.wall((_HALF, _DEPTH), (-_HALF, _DEPTH), _HEIGHT, kit.textured(dice, paper, bricks, checker)),
        kit.wall((-_HALF, _DEPTH), (-_HALF, -2), _HEIGHT, kit.textured(dice, paper, stripes)),
        kit.wall((_HALF, -2), (_HALF, _DEPTH), _HEIGHT, kit.textured(dice, paper, stripes)),
        kit.wall((-_HALF, -2), (_HALF, -2), _HEIGHT, kit.textured(dice, paper, bricks)),
        *(kit.panel(1.2, 1.3, 20.0, still(window), (0.8, 0.9, 1.0)) for window in windows),
    ]


def _table(
    dice: Dice, x: float, z: float, number: int, top: Pixels, seat: Pixels, parameters: Parameters
) -> list[SceneObject]:
    """A table with chairs around it, a curved reflector and a plate on it, a lamp above it."""
    here = kit.standing(x, z, dice.uniform(0, 6))
    chairs = merged(
        [
            placed(furniture.chair(), rotation(kit.UP, turn + dice.uniform(-0.3, 0.3)) @ translation((0, 0, 0.75)))
            for turn in (0, 2.1, 4.2)
        ]
    )
    vase = placed(shapes.vase(dice), translation((0, 1.06, 0)), 0.32)
    globe = placed(shapes.sphere(), translation((0, 0.99, 0)), 0.25)
    places = [translation((0.36 * np.cos(a), 0.74, 0.36 * np.sin(a))) for a in (0.5, 2.6, 4.7)]
    plates = merged([placed(furniture.plate(), place) for place in places])
    metal = kit.plain(dice.uniform(0.05, 0.15), dice.choice([0.05, 0.5]), 0.92)
    lamp = translation((x, 2.1, z))
    return [
        kit.thing(furniture.round_table(0.5), top, here, "glossy", parameters.roughness),
        kit.thing(chairs, seat, here),
        kit.thing(vase if number % 2 else globe, metal, here, "metal", dice.uniform(0.08, 0.25)),
        kit.thing(plates, kit.plain(0.1, 0.05, 0.85), here, "glossy", 0.2),
        kit.thing(furniture.lamp_shade(0.22, 0.2), kit.plain(dice.uniform(), 0.6, 0.7), still(lamp)),
        kit.panel(0.28, 0.28, 1.5, still(lamp @ kit.DOWNWARDS), (1.0, 0.75, 0.45)),  # below, where it lights no shade
    ]


def _camera(dice: Dice, speed: float) -> Camera:
    """A camera that slides sideways past the tables and turns the other way."""
    side = dice.choice([-1, 1])
    slide, swing = speed * dice.apart(0.05, 0.12) * side, speed * dice.uniform(0.1, 0.25) * side
    eye = kit.drifting((-6 * slide, dice.uniform(1.35, 1.7), -0.9), (slide, 0, 0.2 * abs(slide)))
    return kit.camera(eye, kit.drifting((6 * swing, 0.8, 4.0), (-swing, 0, 0)), 60)
