"""Scenes with one kind of motion each, for filters that blur it. Tracks are defined within the shutter too."""

from dataclasses import dataclass

import numpy as np

from nte.render.scenes import kit, shapes
from nte.render.scenes.family import Dice, between, one_of
from nte.render.scenes.patterns import checker, dots, stripes
from nte.render.scenes.solids import block, cushion, merged, placed
from nte.render.world.scene import Camera, Scene, SceneObject
from nte.render.world.transforms import Floats, Track, attached, look_at, rotation, still, translation


@dataclass
class Parameters:
    """case: what moves. speed: at 1 the image moves by 1 to 2 px a frame for sideways_slow, by 4 to 16 for others."""

    case: str = one_of("sideways_fast", "sideways_slow", "rotation", "crossing", "propeller", "still")
    speed: float = between(1.0, 0.0, 4.0)


def make_motion_blur(dice: Dice, parameters: Parameters) -> Scene:
    """Make a stage with three posts and two objects that cross, spin or stand."""
    pace = parameters.speed * dice.apart(0.75, 1.3) * dice.choice([-1, 1])
    floor = kit.textured(dice, kit.shades(dice.uniform(), 0.3, (0.8, 0.6, 0.35)), checker, dots)
    paper = kit.textured(dice, kit.shades(dice.uniform(), 0.45, (0.9, 0.6, 0.3)))
    overhead = kit.aimed(kit.fixed((dice.uniform(-2, 2), 5.0, -2.2)), (0, 0.6, 1.2))
    objects = [
        kit.ground(24, 14, floor, texture_size=3.0),
        kit.wall((12, 4.2), (-12, 4.2), 7, paper, texture_size=3.5),
        kit.panel(2.2, 2.2, 130.0, overhead),
        *_posts(dice),
        *_actors(dice, parameters.case, pace),
    ]
    return Scene(tuple(objects), _camera(parameters.case, pace))


def _posts(dice: Dice) -> list[SceneObject]:
    """Posts at several depths, for parallax and for edges along and across the motion."""
    posts = []
    for x, z in ((-1.9, 0.6), (1.8, 1.6), (0.3, 2.8)):
        post = merged([block((0.3, dice.uniform(1.2, 2.2), 0.3)), block((0.8, 0.2, 0.5))])
        color = kit.textured(dice, kit.shades(dice.uniform(), 0.5, (0.85, 0.6, 0.35)))
        posts.append(kit.thing(post, color, kit.standing(x + dice.uniform(-0.2, 0.2), z, dice.uniform(0, 1.5))))
    return posts


def _actors(dice: Dice, case: str, pace: float) -> list[SceneObject]:
    """Two boxes that cross, or two propellers; in the other cases the boxes stand."""
    tones = [kit.shades(dice.uniform(), 0.7, (0.95, 0.6, 0.3)) for _ in range(2)]
    colours = [kit.textured(dice, tone, checker, stripes, dots) for tone in tones]
    if case == "propeller":
        blade = cushion((0.24, 0.9, 0.05), 0.02, (0, 0.08, 0), 0.6)
        rotor = merged([placed(blade, rotation((0, 0, 1), turn)) for turn in 2 * np.pi * np.arange(3) / 3])
        hub = placed(shapes.sphere(), np.eye(4), 0.14)
        spin: Track = lambda time: rotation((0, 0, 1), 0.3 * pace * time)  # noqa: E731
        places = ((-0.85, 1.35, 0.2), (1.0, 1.1, 1.0))
        return [
            kit.thing(merged([rotor, hub]), color, attached(still(translation(place)), spin))
            for place, color in zip(places, colours, strict=True)
        ]
    crosses = case == "crossing"
    way, apart = 0.3 * pace * crosses, 0.9 * (not crosses)
    tracks = [
        kit.following(kit.drifting((side * (apart - 4.5 * way), height, z), (side * way, 0, 0)))
        for side, height, z in ((1, 0.25, -0.2), (-1, 0.55, 0.9))
    ]
    return [
        kit.thing(cushion((0.7, 0.7, 0.7), 0.06, texture_size=1.2), color, track)
        for color, track in zip(colours, tracks, strict=True)
    ]


def _camera(case: str, pace: float) -> Camera:
    eye, target = np.array([0, 1.5, -4.0]), np.array([0, 0.9, 1.2])
    if case == "rotation":

        def turning(time: float) -> Floats:
            return rotation(kit.UP, 0.09 * pace * (time - 4.5)) @ look_at(eye, target)

        return Camera(turning, 50)
    slide = {"sideways_fast": 0.35, "sideways_slow": 0.06}.get(case, 0.0) * pace
    start = np.array([-4.5 * slide, 0, 0])
    return kit.camera(kit.drifting(eye + start, (slide, 0, 0)), kit.drifting(target + start, (slide, 0, 0)), 50)
