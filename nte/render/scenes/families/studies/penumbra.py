"""Lights that move over a relief with a few bars above it: penumbrae on an uneven receiver, and nothing else moves."""

from dataclasses import dataclass

import numpy as np

from nte.render.scenes import kit
from nte.render.scenes.family import Dice, between
from nte.render.scenes.solids import capsule, merged, placed, sheet
from nte.render.world.scene import Mesh, Scene
from nte.render.world.transforms import Floats, rotation, still, translation


@dataclass
class Parameters:
    """light_size: side of each light. lights: how many move. bars: how many cast shadows."""

    light_size: float = between(0.5, 0.05, 2.0)
    lights: int = between(1, 1, 3)
    bars: int = between(5, 0, 12)


def make_penumbra(dice: Dice, parameters: Parameters) -> Scene:
    """Make a relief with bumps, ridges and steps, seen obliquely from above."""
    color = kit.textured(dice, kit.shades(dice.apart(0.0, 1.0), 0.4, (0.85, 0.72, 0.6)))
    objects = [kit.thing(sheet(14, 14, _relief(dice), 3.0, cells=200), color, still())]
    if parameters.bars:
        bars = merged([_bar(dice, number, parameters.bars) for number in range(parameters.bars)])
        objects.append(kit.thing(bars, kit.textured(dice, kit.shades(dice.uniform(), 0.5)), still()))
    rate = dice.apart(0.12, 0.3)
    for number in range(parameters.lights):
        phase, side = dice.uniform(-0.5, 0.5) + 2 * number, dice.choice([-1, 1])
        path = kit.swaying((0, 3.0, 1.2), (2.8 * side, 0, dice.uniform(-0.8, 0.8)), rate, phase)
        light = kit.aimed(path, (0, 0, 0.3))
        objects.append(kit.panel(parameters.light_size, parameters.light_size, 45.0 / parameters.lights, light))
    eye = kit.swaying((dice.uniform(-0.5, 0.5), 3.6, -3.2), (0, 0, 0), 0)
    return Scene(tuple(objects), kit.camera(eye, kit.fixed((0, 0, 0.1)), 46))


def _relief(dice: Dice) -> kit.Height:
    """Ridges across, rows of bumps, and low waves."""
    turn, wavelength = dice.uniform(0, np.pi), dice.uniform(0.9, 1.4)
    phases, directions = dice.uniform(0, 6, 3), dice.normal(size=(3, 2))

    def height(x: Floats, z: Floats) -> Floats:
        a, b = np.cos(turn) * x + np.sin(turn) * z, np.cos(turn) * z - np.sin(turn) * x
        ridges = 0.5 + 0.5 * np.tanh(3 * np.sin(2 * np.pi * a / (1.5 * wavelength)))
        bumps = np.maximum(np.sin(2 * np.pi * a / wavelength) * np.sin(2 * np.pi * b / wavelength), 0) ** 0.7
        waves = np.sin(x[:, None] * directions[:, 0] + z[:, None] * directions[:, 1] + phases).sum(1)
        return np.asarray(0.14 * ridges + 0.25 * bumps + 0.05 * waves)

    return height


def _bar(dice: Dice, number: int, count: int) -> Mesh:
    """A rod that floats over the relief; lower rods have harder shadows."""
    x = (number + 0.5) / count * 3.6 - 1.8 + dice.uniform(-0.2, 0.2)
    place = (x, dice.uniform(0.6, 1.2), dice.uniform(-0.6, 1.0))
    lying = rotation(kit.UP, dice.uniform(0, np.pi)) @ rotation((0, 0, 1), np.pi / 2 + dice.uniform(-0.3, 0.3))
    return placed(capsule(dice.uniform(0.8, 1.3), 0.09), translation(place) @ lying)
