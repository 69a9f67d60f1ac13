"""A laid table with glasses, bottles, plates and fruit, lit mostly by indirect light: use a max_depth of 5 or more."""

from dataclasses import dataclass

import numpy as np

from nte.render.scenes import furniture, kit, shapes
from nte.render.scenes.family import Dice, between, switch
from nte.render.scenes.patterns import bricks, checker, marble, noise, stripes
from nte.render.scenes.solids import block, merged, placed
from nte.render.world.scene import Mesh, Pixels, Scene, SceneObject, Surface
from nte.render.world.transforms import Floats, rotation, still, translation

_HALF, _DEPTH, _HEIGHT, _TOP = 2.4, 4.6, 2.7, 0.74  # of the room, and height of the table


@dataclass
class Parameters:
    """guests: places laid on each side. moving_camera: whether the camera slides along the table."""

    guests: int = between(2, 1, 3)
    moving_camera: bool = switch(True)


def make_dining(dice: Dice, parameters: Parameters) -> Scene:
    """Make a table along x, lit by a panel that shines up at the ceiling and by a window."""
    objects = [*_room(dice), *_table(dice, parameters.guests), *_middle(dice)]
    slide = dice.apart(0.02, 0.06) * dice.choice([-1, 1]) * parameters.moving_camera
    eye = kit.drifting((dice.uniform(-0.3, 0.3) - 4 * slide, 1.4, 0.5), (slide, 0, 0))
    return Scene(tuple(objects), kit.camera(eye, kit.fixed((0, 0.8, 1.75)), 52))


def _room(dice: Dice) -> list[SceneObject]:
    paper = kit.shades(dice.apart(0, 1), 0.35, (0.85, 0.7, 0.55))
    lid = shapes.rectangle((-_HALF, _HEIGHT, -1), (2 * _HALF, 0, 0), (0, 0, _DEPTH + 1))
    picture = shapes.rectangle((0.6, 1.2, _DEPTH - 0.03), (-1.2, 0, 0), (0, 0.8, 0))
    boards = kit.textured(dice, kit.shades(0.08, 0.5, (0.6, 0.45, 0.3)), bricks)
    up, sideways = rotation((1, 0, 0), -np.pi / 2), rotation(kit.UP, -np.pi / 2)
    return [
        kit.ground(2 * _HALF, 2 * _DEPTH, boards, texture_size=2.4),
        kit.thing(lid, kit.plain(0.12, 0.05, 0.9), still()),
        kit.wall((_HALF, _DEPTH), (-_HALF, _DEPTH), _HEIGHT, kit.textured(dice, paper, stripes, bricks), 2.5),
        kit.wall((-_HALF, _DEPTH), (-_HALF, -1), _HEIGHT, kit.textured(dice, paper, stripes), 2.5),
        kit.wall((_HALF, -1), (_HALF, _DEPTH), _HEIGHT, kit.textured(dice, paper, stripes), 2.5),
        kit.wall((-_HALF, -1), (_HALF, -1), _HEIGHT, kit.plain(0.1, 0.2, 0.7)),
        kit.thing(picture, kit.textured(dice, kit.shades(dice.uniform(), 0.8)), still()),
        kit.panel(1.6, 0.5, 10.0, still(translation((0, 2.1, 1.9)) @ up), (1.0, 0.85, 0.65)),
        kit.panel(1.4, 1.2, 9.0, still(translation((_HALF - 0.03, 1.6, 1.4)) @ sideways), (0.85, 0.92, 1.0)),
    ]


def _table(dice: Dice, guests: int) -> list[SceneObject]:
    """A table with cloth and chairs, and at every place a plate, a knife, a fork and a glass."""
    wood = kit.textured(dice, kit.shades(dice.uniform(0.03, 0.12), 0.55), marble)
    linen = kit.textured(dice, kit.shades(dice.uniform(), 0.4, (0.9, 0.75, 0.55)), checker, stripes)
    runner = shapes.rectangle((-0.95, _TOP + 0.004, 1.9 - 0.5), (0, 0, 1.0), (1.9, 0, 0), 0.8)
    seats, plates, knives, glasses = list[Mesh](), list[Mesh](), list[Mesh](), list[Mesh]()
    for along in (np.arange(guests) - (guests - 1) / 2) * 1.7 / guests:
        for side in (-1, 1):
            turn = rotation(kit.UP, 0.0 if side > 0 else np.pi)
            place = translation((along, 0, 1.9)) @ turn
            if side > 0:  # chairs in front would hide the table
                drawn_up = translation((0, 0, 0.75)) @ rotation(kit.UP, dice.uniform(-0.2, 0.2))
                seats.append(placed(furniture.chair(), place @ drawn_up))
            plates.append(placed(furniture.plate(), place @ translation((0, _TOP, 0.32))))
            knife = block((0.018, 0.006, 0.2))
            knives += [placed(knife, place @ translation((x, _TOP + 0.005, 0.32))) for x in (-0.17, 0.17)]
            glasses.append(placed(furniture.glass(), place @ translation((0.2, _TOP, 0.12))))
    return [
        kit.thing(furniture.table(2.0, 1.1, _TOP), wood, kit.standing(0, 1.9)),
        kit.thing(runner, linen, still()),
        kit.thing(merged(seats), wood, still()),
        kit.thing(merged(plates), kit.plain(0.6, 0.04, 0.85), still(), "glossy", 0.15),
        kit.thing(merged(knives), kit.plain(0.1, 0.03, 0.9), still(), "metal", 0.2),
        kit.thing(merged(glasses), kit.plain(0.5, 0.02, 0.98), still(), "glass", 0.05),
    ]


def _middle(dice: Dice) -> list[SceneObject]:
    """Bottles, a bowl with fruit, a lazy Susan that turns, and an orange that rolls along the table."""
    spin, roll = dice.apart(0.06, 0.16) * dice.choice([-1, 1]), dice.uniform(0.03, 0.06) * dice.choice([-1, 1])

    def turning(time: float) -> Floats:
        return translation((0, _TOP, 1.9)) @ rotation(kit.UP, spin * time)

    def rolling(time: float) -> Floats:
        way = roll * (time - 5)
        return translation((way, _TOP + 0.045, 1.68)) @ rotation((0, 0, 1), -way / 0.045)

    def ring(radius: float, angle: float) -> Floats:
        return translation((radius * np.cos(angle), 0.03, radius * np.sin(angle)))

    bowl = placed(furniture.plate(0.5), ring(0.14, 0), (0.28, 1.6, 0.28))
    spots = [ring(0.14 + 0.07 * np.cos(angle), angle / 6) for angle in (0.5, 2.6, 4.7)]
    fruit = merged([placed(furniture.apple(dice)[0], spot, 0.042) for spot in spots])
    board = placed(shapes.cylinder(), np.eye(4), (0.42, 0.015, 0.42))
    tray: list[tuple[Mesh, Pixels, Surface, float]] = [
        (board, kit.textured(dice, kit.shades(0.07, 0.6), marble), "glossy", 0.25),
        (placed(furniture.bottle(), ring(0.15, 2.2)), kit.plain(0.3, 0.75, 0.5), "glass", 0.08),
        (placed(furniture.bottle(0.24), ring(0.16, 3.6)), kit.plain(0.02, 0.8, 0.5), "glossy", 0.2),
        (bowl, kit.plain(0.1, 0.3, 0.9), "metal", 0.2),
        (fruit, kit.textured(dice, kit.shades(dice.choice([0.0, 0.2]), 0.8), noise), "glossy", 0.4),
    ]
    objects = [kit.thing(mesh, color, turning, surface, rough) for mesh, color, surface, rough in tray]
    peel = kit.textured(dice, kit.shades(0.08, 0.9, (0.95, 0.8, 0.6)), checker, stripes)
    return [*objects, kit.thing(placed(shapes.sphere(), np.eye(4), 0.045), peel, rolling, "glossy", 0.4)]
