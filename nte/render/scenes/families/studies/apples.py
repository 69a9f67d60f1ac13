"""Apples on wavy cloth under a moving area light: soft shadows that slide over curved receivers."""

from dataclasses import dataclass

import numpy as np

from nte.render.scenes import furniture, kit
from nte.render.scenes.family import Dice, between, switch
from nte.render.scenes.patterns import checker, dots, noise, stripes
from nte.render.scenes.solids import placed, sheet
from nte.render.world.scene import Scene, SceneObject
from nte.render.world.transforms import Floats, rotation, still, translation


@dataclass
class Parameters:
    """apples: how many lie there. light_size: side of the light. rolling: whether one apple rolls across."""

    apples: int = between(7, 1, 12)
    light_size: float = between(0.9, 0.2, 2.0)
    rolling: bool = switch(False)


def make_apples(dice: Dice, parameters: Parameters) -> Scene:
    """Make a cloth with folds, apples on it, and one light that swings over them."""
    heights = _folds(dice)
    weave = kit.textured(dice, kit.shades(dice.apart(0.0, 1.0), 0.35, (0.85, 0.7, 0.5)), checker, stripes, dots)
    objects = [kit.thing(sheet(14, 14, heights, 1.8, cells=140), weave, still())]
    for number, (x, z) in enumerate(_places(dice, parameters.apples, parameters.rolling)):
        objects += _apple(dice, x, z, heights, parameters.rolling and number == 0)
    rate, phase, way = dice.apart(0.12, 0.28), dice.uniform(-0.6, 0.6), dice.choice([-1, 1])
    path = kit.swaying((0, 3.6, 0.8), (2.2 * way, 0, dice.uniform(-0.6, 0.6)), rate, phase)
    side = parameters.light_size
    objects.append(kit.panel(side, side, 55.0, kit.aimed(path, (0, 0, 0.2)), (1.0, 0.93, 0.82)))
    eye = kit.swaying((dice.uniform(-0.4, 0.4), 2.6, -2.9), (0.5 * dice.choice([-1, 1]), 0, 0), 0.2)
    return Scene(tuple(objects), kit.camera(eye, kit.fixed((0, 0.25, 0.1)), 46))


def _folds(dice: Dice) -> kit.Height:
    """Waves across the cloth, which is nowhere flat."""
    directions, phases = dice.normal(size=(5, 2)) * 1.7, dice.uniform(0, 6, 5)

    def height(x: Floats, z: Floats) -> Floats:
        waves = np.sin(x[:, None] * directions[:, 0] + z[:, None] * directions[:, 1] + phases)
        return np.asarray(0.07 * waves.sum(1))

    return height


def _places(dice: Dice, count: int, rolling: bool) -> list[tuple[float, float]]:
    """Places on the cloth, an apple apart where there is room; if the first apple rolls, its way is free."""
    places = [(0.0, -0.9)] if rolling else []
    while len(places) < count:
        for _ in range(200):
            x, z = dice.uniform(-1.5, 1.5), dice.uniform(-0.15 if rolling else -1.0, 1.6)
            if all(np.hypot(x - a, z - b) > 0.72 for a, b in places):
                break
        places.append((x, z))
    return places


def _apple(dice: Dice, x: float, z: float, heights: kit.Height, rolls: bool) -> list[SceneObject]:
    """Body and stem of an apple that leans a little on the cloth."""
    size = dice.uniform(0.3, 0.38)
    lean = rotation(dice.normal(size=3) * (1, 0.1, 1), dice.uniform(0, 0.5))
    ground = float(heights(np.array([x]), np.array([z]))[0]) - 0.03
    spin = dice.uniform(0, 6)
    track = still(translation((x, ground, z)) @ rotation(kit.UP, spin) @ lean)
    if rolls:
        middle, radius, speed = np.array([0, 0.9 * size, 0]), 0.95 * size, 0.12

        def track(time: float) -> Floats:
            way = speed * (time - 4)
            place = translation((way, ground + 0.25 * size, z)) @ translation(middle)
            return place @ rotation((0, 0, 1), -way / radius) @ lean @ translation(-middle)

    skin = kit.shades(dice.choice([0.0, 0.02, 0.98, 0.1, 0.25]), 0.8, (0.75, 0.6, 0.35))
    body, stem = (placed(mesh, np.eye(4), size) for mesh in furniture.apple(dice))
    return [
        kit.thing(body, kit.textured(dice, skin, noise, dots), track, "glossy", 0.35),
        kit.thing(stem, kit.plain(0.08, 0.6, 0.25), track),
    ]
