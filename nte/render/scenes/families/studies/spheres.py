"""Balls that bounce and circle in soft light, out of focus near and far; shadows sharpen as a ball comes down."""

from dataclasses import dataclass, replace

import numpy as np

from nte.render.scenes import kit, shapes
from nte.render.scenes.family import Dice, between
from nte.render.scenes.solids import placed
from nte.render.world.scene import Scene, SceneObject, Surface
from nte.render.world.transforms import Floats, rotation, translation


@dataclass
class Parameters:
    """spheres: how many. light_size: side of the light, which sets how soft the shadows are.

    aperture: radius of the lens; 0 is a pinhole. The middle of the ring of balls is in focus.
    """

    spheres: int = between(8, 1, 16)
    light_size: float = between(1.6, 0.1, 3.0)
    aperture: float = between(0.25, 0.0, 1.0)


def make_spheres(dice: Dice, parameters: Parameters) -> Scene:
    """Make a floor and two walls with balls; every other ball bounces, the rest roll on circles."""
    side = parameters.light_size
    tints = kit.shades(dice.apart(0, 1), 0.3, (0.85, 0.65, 0.45))
    objects = [
        kit.ground(14, 12, kit.textured(dice, tints), texture_size=3.0),
        kit.wall((7, 3.6), (-7, 3.6), 6, kit.textured(dice, tints)),
        kit.panel(side, side, 90.0, kit.aimed(kit.fixed((-1.8, 5.0, -1.2)), (0, 0, 0.8))),
    ]
    objects += [_ball(dice, number, parameters.spheres) for number in range(parameters.spheres)]
    eye = kit.swaying((0, 2.3, -4.4), (0.3 * dice.choice([-1, 1]), 0, 0), 0.2)
    camera = replace(kit.camera(eye, kit.fixed((0, 0.6, 0.8)), 46), aperture=parameters.aperture)
    middle = camera.view(0) @ (0, 0.4, 1.0, 1)
    return Scene(tuple(objects), replace(camera, focus=float(middle[2])))


def _ball(dice: Dice, number: int, count: int) -> SceneObject:
    radius = dice.uniform(0.22, 0.42)
    angle = 2 * np.pi * (number + dice.uniform(0, 0.5)) / count
    distance = dice.uniform(0.9, 2.0)
    rate, phase = dice.uniform(0.2, 0.35), dice.uniform(0, 3)
    way = dice.apart(0.06, 0.2) * dice.choice([-1, 1])
    jump = dice.uniform(0.6, 1.4) * (number % 2 == 0)

    def track(time: float) -> Floats:
        turn = angle + way / distance * time
        up = radius + jump * abs(np.sin(rate * time + phase))
        place = translation((distance * np.cos(turn), up, 1.0 + 0.8 * distance * np.sin(turn)))
        return place @ rotation((np.cos(turn), 0.0, np.sin(turn)), way / radius * time)

    kinds: tuple[tuple[Surface, float], ...] = (("diffuse", 1.0), ("glossy", 0.3), ("metal", 0.2), ("diffuse", 1.0))
    surface, roughness = kinds[number % 4]
    color = kit.textured(dice, kit.shades(dice.uniform(), 0.6, (0.9, 0.65, 0.4)))
    return kit.thing(placed(shapes.sphere(), np.eye(4), radius), color, track, surface, roughness)
