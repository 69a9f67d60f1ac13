"""A beam that tilts behind a translucent slab: the glow in it wanders and changes its shape, and nothing else moves."""

from dataclasses import dataclass

import numpy as np

from nte.render.scenes import kit
from nte.render.scenes.family import Dice, between
from nte.render.scenes.solids import cushion, turned
from nte.render.world.scene import Material, Medium, Scene, SceneObject
from nte.render.world.transforms import Floats, rotation, still, translation

_LEAST_DEPTH = 32
_MIDDLE = 4.5  # the frame at which the beam is level, the middle of ten frames


@dataclass
class Parameters:
    """extinction: of the slab, per unit; the slab is 0.6 thick. tilt: 1 turns the beam by 6 to 10 degrees per frame."""

    extinction: float = between(12.0, 4.0, 40.0)
    tilt: float = between(1.0, 0.0, 3.0)


def make_subsurface(dice: Dice, parameters: Parameters) -> Scene:
    """Make a slab on a table, lit from behind by a torch that turns about its lens, seen from the other side."""
    absorbed = np.array([0.002, 0.006, 0.015]) * dice.uniform(0.3, 2.0)
    r, g, b = 1 - dice.permutation(absorbed)
    veil = Material(kit.plain(dice.uniform(), 0.2, 0.8), "veil")
    inside = Medium(parameters.extinction, (r, g, b), 0.97)
    slab = SceneObject(cushion((3.0, 2.2, 0.6), 0.12), veil, still(), medium=inside)
    wood = kit.textured(dice, kit.shades(dice.uniform(0, 0.1), 0.5, (0.3, 0.2, 0.12)))
    table = kit.ground(14, 12, wood, texture_size=3.0)
    place = (dice.uniform(-0.25, 0.25), dice.uniform(1.05, 1.3), 1.3)
    slant, rate = dice.uniform(-0.4, 0.4), np.radians(parameters.tilt * dice.apart(6, 10) * dice.choice([-1, 1]))

    def swing(time: float) -> Floats:
        """Place and turn the torch, which shines along its own −y."""
        turn = rotation((np.sin(slant), np.cos(slant), 0), rate * (time - _MIDDLE))
        return translation(place) @ turn @ rotation((1, 0, 0), np.pi / 2)

    hood = kit.thing(turned([(0.32, -0.5), (0.32, -0.2), (0.32, 0.1)]), np.zeros((1, 1, 3), np.float32), swing)
    lamp = kit.panel(0.5, 0.5, 6.0, lambda time: swing(time) @ kit.DOWNWARDS)
    camera = kit.camera(kit.fixed((0, 1.9, -4.2)), kit.fixed((0, 1.0, 0)), 46)
    return Scene((slab, table, hood, lamp), camera, (0.3, 0.33, 0.4), _LEAST_DEPTH)
