"""Sun and sky through a window in the side wall of a room, with dimmed lamps and a glass object in the light."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from nte.render.scenes.kit import sky
from nte.render.scenes.solids import Size, framed
from nte.render.world.scene import Camera, Material, Scene, SceneObject


def let_daylight_in(size: Size, rng: np.random.Generator, objects: Sequence[SceneObject], camera: Camera) -> Scene:
    """Return the scene of a room with a window in a side wall, and with the room's own lights dimmed.

    size: width, height and depth of the room. objects: the second and third must be its side walls; the last becomes
    glass.
    """
    width, height, depth = size
    side = int(rng.integers(2))
    x = width / 2 * (-1, 1)[side]
    corner, along = ((x, 0, depth), (0, 0, -depth)) if side == 0 else ((x, 0, 0), (0, 0, depth))
    hole = (rng.uniform(0.15, 0.3), rng.uniform(0.7, 0.85), rng.uniform(0.15, 0.25), rng.uniform(0.8, 0.9))
    changed = [_dimmed(obj, 0.25) for obj in objects]
    changed[1 + side] = replace(changed[1 + side], mesh=framed(corner, along, (0, height, 0), hole))
    tint = Material(np.array([[rng.uniform(0.75, 1, 3)]], np.float32), "glass", rng.uniform(0.05, 0.15))
    changed[-1] = replace(changed[-1], material=tint)
    sun = (x, rng.uniform(0.5, 0.8) * abs(x), rng.uniform(-1.5, 1.5))
    return Scene(tuple(changed), camera, sky(rng, sun, rng.uniform(1.2, 2.5)))


def _dimmed(obj: SceneObject, share: float) -> SceneObject:
    if obj.radiance is None:
        return obj
    r, g, b = obj.radiance
    return replace(obj, radiance=(r * share, g * share, b * share))
