"""A fence that moves fast before area lights: its shadows cross textured ground faster than anything visible moves."""

from dataclasses import dataclass

import numpy as np

from nte.render.scenes import kit
from nte.render.scenes.family import Dice, between, switch
from nte.render.scenes.patterns import bricks, checker, dots, marble, noise
from nte.render.scenes.solids import block, merged
from nte.render.world.scene import Colour, Scene, SceneObject

_SPACING = 0.55  # between slats
_LENGTH = 36  # slats: enough that no end comes into view within a clip
_TINTS: tuple[Colour, ...] = ((1.0, 0.95, 0.85), (0.75, 0.85, 1.0), (1.0, 0.7, 0.45), (0.7, 1.0, 0.75))


@dataclass
class Parameters:
    """lights: area lights behind the fence. moving_lights: whether they travel. moving_camera: likewise the camera."""

    lights: int = between(1, 1, 4)
    moving_lights: bool = switch(False)
    moving_camera: bool = switch(False)


def make_fence(dice: Dice, parameters: Parameters) -> Scene:
    """Make a fence over ground seen from above; the lights stand behind it, so shadows fall towards the viewer."""
    soil = kit.textured(dice, kit.shades(dice.apart(0.05, 0.35), 0.35, (0.8, 0.55, 0.3)), checker, bricks, noise, dots)
    bricks_behind = kit.textured(dice, kit.shades(dice.uniform(), 0.4, (0.85, 0.6, 0.4)), bricks, marble)
    objects = [kit.ground(40, 12, soil, texture_size=3.0), kit.wall((20, 5), (-20, 5), 6, bricks_behind)]
    objects += [_fence(dice), *_stones(dice)]
    objects += [_light(dice, number, parameters) for number in range(parameters.lights)]
    glide = dice.uniform(0.4, 0.8) * dice.choice([-1, 1]) * parameters.moving_camera
    eye = kit.swaying((dice.uniform(-0.6, 0.6), 3.4, -4.0), (glide, 0, 0.2 * glide), 0.25)
    return Scene(tuple(objects), kit.camera(eye, kit.fixed((0, 0, 0.2)), 50))


def _fence(dice: Dice) -> SceneObject:
    """Slats between two rails, which run sideways by three to eight pixels per frame at 128 pixels."""
    height, width = dice.uniform(1.1, 1.5), dice.uniform(0.14, 0.24)
    slats = [
        block((width, height + 0.1 * np.sin(2.1 * i), 0.05), ((i - _LENGTH / 2) * _SPACING, 0.05, 0), 1.0)
        for i in range(_LENGTH)
    ]
    rails = [block((_LENGTH * _SPACING, 0.08, 0.04), (0, y * height, 0.04), 1.0) for y in (0.25, 0.75)]
    wood = kit.textured(dice, kit.shades(dice.uniform(0.02, 0.12), 0.5), marble)
    speed = dice.apart(0.1, 0.32) * dice.choice([-1, 1])
    return kit.thing(merged([*slats, *rails]), wood, kit.following(kit.drifting((0, 0, 0.5), (speed, 0, 0))))


def _stones(dice: Dice) -> list[SceneObject]:
    """Two low objects on the ground, on which shadows bend."""
    stones = []
    for side in (-1, 1):
        size = (dice.uniform(0.3, 0.6), dice.uniform(0.15, 0.35), dice.uniform(0.3, 0.6))
        track = kit.standing(side * dice.uniform(0.5, 1.4), dice.uniform(-1.6, -0.6), dice.uniform(0, 1.5))
        color = kit.textured(dice, kit.shades(dice.uniform(), 0.5))
        stones.append(kit.thing(block(size, texture_size=0.8), color, track))
    return stones


def _light(dice: Dice, number: int, parameters: Parameters) -> SceneObject:
    """A panel behind the fence, just above the camera's view; if lights move, those after the first travel sideways."""
    x = dice.uniform(-1.5, 1.5) + (0.0, 2.5, -2.5, 0.5)[number]
    reach = dice.uniform(0.8, 1.6) * dice.choice([-1, 1]) * parameters.moving_lights
    rate, phase = dice.uniform(0.15, 0.3), dice.uniform(-0.8, 0.8)
    path = kit.swaying((x, 2.6 + 0.25 * number, 4.2), (reach, 0.2 * reach, 0), rate, phase)
    size = dice.uniform(0.35, 0.8)
    return kit.panel(size, size, 60.0 / parameters.lights, kit.aimed(path, (0, 0, 0)), _TINTS[number])
