"""A furnished pink room in which a few things move: a ball, a toy car, a chair that slides, a lamp that swings."""

from dataclasses import dataclass

import numpy as np

from nte.render.scenes import furniture, kit, shapes
from nte.render.scenes.family import Dice, switch
from nte.render.scenes.patterns import bricks, checker, dots, marble, noise, stripes
from nte.render.scenes.solids import cushion, merged, placed
from nte.render.world.scene import Mesh, Pixels, Scene, SceneObject
from nte.render.world.transforms import Floats, Track, attached, rotation, still, translation

_HALF, _DEPTH, _HEIGHT = 2.3, 4.8, 2.7  # of the room; the camera stands at z < 0
_PINK = 0.94  # hue


@dataclass
class Parameters:
    """swinging_lamp: whether the hanging lamp, and so every shadow, moves. moving_camera: whether the camera does."""

    swinging_lamp: bool = switch(False)
    moving_camera: bool = switch(False)


def make_pinkroom(dice: Dice, parameters: Parameters) -> Scene:
    """Make a room with a bed and a shelf at the back, a table with chairs in front, lamps, and things that move."""
    objects = [*_room(dice), *_bed(dice), *_shelf(dice), *_seats(dice), *_lights(dice, parameters), *_movers(dice)]
    glide = dice.uniform(0.3, 0.5) * dice.choice([-1, 1]) * parameters.moving_camera
    eye = kit.swaying((dice.uniform(-0.3, 0.3), 1.55, -1.2), (glide, 0, 0), 0.2)
    return Scene(tuple(objects), kit.camera(eye, kit.fixed((0, 0.85, 2.4)), 58))


def _room(dice: Dice) -> list[SceneObject]:
    pink = kit.shades(_PINK + dice.apart(-0.04, 0.05), 0.35, (0.9, 0.75, 0.65))
    boards = kit.textured(dice, kit.shades(0.07, 0.5, (0.65, 0.5, 0.3)), bricks)
    lid = shapes.rectangle((-_HALF, _HEIGHT, -2), (2 * _HALF, 0, 0), (0, 0, _DEPTH + 2))
    rug = shapes.rectangle((-1.0, 0.012, 2.2), (2.0, 0, 0), (0, 0, -1.5), 1.4)
    return [
        kit.ground(2 * _HALF, 2 * _DEPTH, boards, texture_size=2.4),
        kit.thing(lid, kit.plain(_PINK, 0.06, 0.85), still()),
        kit.wall((_HALF, _DEPTH), (-_HALF, _DEPTH), _HEIGHT, kit.textured(dice, pink, dots, stripes), 2.2),
        kit.wall((-_HALF, _DEPTH), (-_HALF, -2), _HEIGHT, kit.textured(dice, pink, stripes), 2.2),
        kit.wall((_HALF, -2), (_HALF, _DEPTH), _HEIGHT, kit.textured(dice, pink, stripes), 2.2),
        kit.wall((-_HALF, -2), (_HALF, -2), _HEIGHT, kit.plain(_PINK, 0.3, 0.8)),
        kit.thing(rug, kit.textured(dice, kit.shades(dice.uniform(), 0.5), checker, dots, marble), still()),
    ]


def _bed(dice: Dice) -> list[SceneObject]:
    here = kit.standing(1.4, 3.65)
    cover = kit.textured(dice, kit.shades(dice.uniform(), 0.4, (0.9, 0.7, 0.5)), checker, dots, stripes)
    pillows = merged([cushion((0.6, 0.16, 0.4), 0.075, (x, 0.58, 0.75)) for x in (-0.35, 0.35)])
    return [
        kit.thing(furniture.bed(), kit.textured(dice, kit.shades(0.07, 0.6, (0.5, 0.4, 0.25)), marble), here),
        kit.thing(cushion((1.45, 0.24, 2.0), 0.1, (0, 0.34, -0.02), 1.2), cover, here),
        kit.thing(pillows, kit.plain(_PINK, 0.1, 0.9), here),
    ]


def _shelf(dice: Dice) -> list[SceneObject]:
    here = kit.standing(-1.35, 4.55)
    levels = np.linspace(0.05, 1.86, 5)[:4] + 0.04
    rows = merged([placed(furniture.books(dice, dice.uniform(0.5, 1.0)), translation((0, y, 0))) for y in levels])
    spines = kit.textured(dice, kit.shades(dice.uniform(), 0.7, (0.8, 0.5, 0.25)), stripes, noise)
    vase = placed(shapes.vase(dice), translation((0.3, 2.05, 0)), 0.15)
    return [
        kit.thing(furniture.shelf(1.2, 1.9, 0.32, 5), kit.plain(0.08, 0.45, 0.6), here),
        kit.thing(rows, spines, here),
        kit.thing(vase, kit.plain(dice.uniform(), 0.6, 0.6), here, "glossy", 0.2),
    ]


def _seats(dice: Dice) -> list[SceneObject]:
    wood = kit.textured(dice, kit.shades(dice.uniform(0.05, 0.12), 0.5, (0.7, 0.55, 0.35)), marble)
    track = still(translation((-1.25, 0, 2.1)) @ rotation(kit.UP, dice.uniform(-0.3, 0.3)))
    bowl = placed(shapes.sphere(), translation((0.1, 0.86, 0)), 0.12)
    return [
        kit.thing(furniture.table(0.8, 0.8), wood, track),
        kit.thing(bowl, kit.plain(0.1, 0.2, 0.9), track, "metal", 0.2),
        kit.thing(furniture.chair(), wood, kit.standing(-1.5, 2.85, dice.uniform(-0.4, 0.4))),
    ]


def _lights(dice: Dice, parameters: Parameters) -> list[SceneObject]:
    """A hanging lamp, a lamp beside the bed, and a window behind the camera."""
    angle, rate = 0.35 * parameters.swinging_lamp, dice.uniform(0.2, 0.35)

    def pendulum(time: float) -> Floats:
        return translation((0.2, _HEIGHT, 2.0)) @ rotation((0.3, 0, 1), angle * np.sin(rate * time))

    hanging = attached(pendulum, still(translation((0, -0.75, 0))))
    shade = kit.textured(dice, kit.shades(dice.uniform(), 0.5, (0.9, 0.8, 0.6)), stripes)
    beside = (0.45, 4.5)
    return [
        kit.thing(furniture.lamp_shade(0.28, 0.22), shade, hanging),
        kit.panel(0.36, 0.36, 3.5, attached(hanging, still(kit.DOWNWARDS)), (1.0, 0.85, 0.65)),
        kit.thing(furniture.stand(1.2), kit.plain(0.1, 0.3, 0.6), kit.standing(*beside), "metal", 0.3),
        kit.bulb(0.15, 0.6, kit.standing(*beside, y=1.3), (1.0, 0.75, 0.5)),
        kit.panel(1.4, 1.2, 16.0, kit.aimed(kit.fixed((-1.2, 1.8, -1.7)), (0.3, 0.6, 3.0)), (0.85, 0.92, 1.0)),
    ]


def _movers(dice: Dice) -> list[SceneObject]:
    """A ball that bounces across, a car on the floor, a chair that is pulled away from the bed."""
    side, speed, rate = dice.choice([-1, 1]), dice.apart(0.06, 0.16), dice.uniform(0.2, 0.3)
    roll = dice.uniform(0.08, 0.15)

    def ball(time: float) -> Floats:
        place = (side * (speed * time - 0.9), 0.2 + 0.9 * abs(np.sin(rate * time + 1)), 1.5)
        return translation(place) @ rotation((0, 0, 1), -side * speed * time / 0.2)

    def car(time: float) -> Floats:
        return translation((side * (1.1 - roll * time), 0, 0.9)) @ rotation(kit.UP, 0.1 * np.sin(0.4 * time))

    def chair(time: float) -> Floats:
        return translation((0.45, 0, 2.5)) @ rotation(kit.UP, 2.5 + 0.12 * time) @ translation((0.2, 0, 0))

    bonnet = cushion((0.5, 0.14, 0.24), 0.05, (0, 0.06, 0), 0.5)
    cabin = cushion((0.26, 0.12, 0.2), 0.05, (0, 0.18, 0), 0.5)
    wheels = merged(
        [
            placed(shapes.cylinder(), translation((x, 0.07, z)) @ rotation((1, 0, 0), np.pi / 2), (0.1, 0.02, 0.1))
            for x in (-0.15, 0.15)
            for z in (-0.12, 0.12)
        ]
    )

    def loud() -> Pixels:
        return kit.textured(dice, kit.shades(dice.uniform(), 0.75, (0.9, 0.6, 0.35)), checker, dots, stripes)

    moving: list[tuple[Mesh, Pixels, Track]] = [
        (placed(shapes.sphere(), np.eye(4), 0.2), loud(), ball),
        (merged([bonnet, cabin]), loud(), car),
        (wheels, kit.plain(0.6, 0.2, 0.1), car),
        (furniture.chair(), loud(), chair),
    ]
    return [kit.thing(mesh, color, track) for mesh, color, track in moving]
