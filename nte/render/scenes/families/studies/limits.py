"""The limits that the paper of reliable motion vectors names, one case each, on the same small stage.

Zeng et al. 2021, «Temporally Reliable Motion Vectors for Real-time Ray Tracing», section 7.
"""

from dataclasses import dataclass

import numpy as np

from nte.render.scenes import kit, shapes
from nte.render.scenes.family import Dice, one_of
from nte.render.scenes.patterns import bricks, checker, dots, stripes
from nte.render.scenes.solids import block, capsule, cushion, merged, placed
from nte.render.world.scene import Camera, Pixels, Scene, SceneObject
from nte.render.world.transforms import Floats, look_at, rotation, still, translation

CASES = (
    "out_of_image", "two_lights", "two_lobes", "sudden_light", "curved_reflector", "thin_shadow", "behind", "cut",
)  # fmt: skip
_EVENT = 5  # the first frame that shows a sudden change


@dataclass
class Parameters:
    """case: which limit the scene shows."""

    case: str = one_of(*CASES)


def make_limits(dice: Dice, parameters: Parameters) -> Scene:
    """Make a floor, a wall, two standing objects, and what the case needs."""
    case = parameters.case
    floor = kit.textured(dice, kit.shades(dice.apart(0, 1), 0.3, (0.8, 0.6, 0.4)), checker, dots)
    paper = kit.textured(dice, kit.shades(dice.uniform(), 0.4, (0.85, 0.6, 0.4)), bricks, stripes)
    is_mirror = case == "two_lobes"
    objects = [
        kit.ground(20, 14, floor, "metal" if is_mirror else "diffuse", 0.3 if is_mirror else 1.0, texture_size=3.0),
        kit.wall((10, 3.2), (-10, 3.2), 6, paper, texture_size=3.0),
        *_standing(dice),
        *_lights(dice, case),
        *_actors(dice, case),
    ]
    return Scene(tuple(objects), _camera(dice, case))


def _standing(dice: Dice) -> list[SceneObject]:
    things = []
    for x, z in ((-1.5, 1.6), (1.4, 2.0)):
        height = dice.uniform(0.6, 1.1)
        mesh = merged([block((0.5, height, 0.5)), placed(shapes.sphere(), translation((0, height + 0.2, 0)), 0.2)])
        place = kit.standing(x + dice.uniform(-0.2, 0.2), z, dice.uniform(0, 1.5))
        things.append(kit.thing(mesh, _bright(dice), place))
    return things


def _lights(dice: Dice, case: str) -> list[SceneObject]:
    """One panel overhead, unless the case is about light."""
    if case == "two_lights":  # the lights cross, and so do the shadows of the objects below them
        rate, middle = dice.apart(0.2, 0.35), (0, 0, 0.8)
        sides = ((-1, (1.0, 0.75, 0.5)), (1, (0.5, 0.75, 1.0)))
        return [
            kit.panel(0.4, 0.4, 35.0, kit.aimed(kit.swaying((0, 3.2, -0.8), (1.8 * side, 0, 0), rate), middle), tint)
            for side, tint in sides
        ]
    if case in ("thin_shadow", "behind"):
        path = kit.swaying((0, 3.4, -0.6), (1.2 * dice.choice([-1, 1]), 0, 0), dice.apart(0.2, 0.35))
        return [kit.panel(0.25, 0.25, 60.0, kit.aimed(path, (0, 0, 0.8)))]
    is_sudden = case == "sudden_light"
    size = 0.6 if is_sudden else 1.8
    main = kit.panel(size, size, 80.0, kit.aimed(kit.fixed((-1.0, 4.2, -0.8)), (0, 0, 1.0)))
    weak = kit.panel(1.2, 1.2, 12.0, kit.aimed(kit.fixed((2.5, 3.0, -1.2)), (0, 0, 1.0)), (0.6, 0.75, 1.0))
    return [main, weak] if is_sudden else [main]


def _actors(dice: Dice, case: str) -> list[SceneObject]:
    """The objects that move, apart from lights and camera."""
    way = dice.choice([-1.0, 1.0])
    pace = dice.apart(0.12, 0.25)
    box = cushion((0.6, 0.6, 0.6), 0.06, texture_size=1.0)
    height = 0.5 * (case == "two_lights")  # in the air, so that its two shadows separate
    crossing = kit.following(kit.drifting((-_EVENT * pace * way, height, 0.8), (pace * way, 0, 0)))
    match case:
        case "two_lights" | "out_of_image":
            return [kit.thing(box, _bright(dice), crossing)]
        case "two_lobes":  # a near and a far object, mirrored in one floor, move in opposite directions
            far = kit.following(kit.drifting((_EVENT * pace * way, 0.9, 2.6), (-pace * way, 0, 0)))
            return [kit.thing(box, _bright(dice), crossing), kit.thing(box, _bright(dice), far)]
        case "sudden_light":  # a shutter before the light, which opens from one frame to the next
            lid = block((1.6, 1.6, 0.05), (0, -0.8, 0))

            def shutter(time: float) -> Floats:
                aside = 4.0 * (time > _EVENT - 0.5)
                return look_at((-0.9 + aside, 3.9, -0.6), (0.1 + aside, 0, 1.0))

            return [kit.thing(lid, kit.plain(0.1, 0.1, 0.5), shutter)]
        case "curved_reflector":
            ball = placed(shapes.sphere(), np.eye(4), 0.6)
            chrome = kit.thing(ball, kit.plain(0.1, 0.1, 0.92), still(translation((0, 0.6, 0.6))), "metal", 0.1)
            return [chrome, kit.thing(box, _bright(dice), kit.following(kit.circling((0, 0, 0.6), 1.4, 0.15 * way)))]
        case "thin_shadow":
            wires = merged([placed(capsule(2.4, 0.015), _lying((-0.9 + 0.3 * i, 1.2, -0.4))) for i in range(7)])
            slow = kit.following(kit.drifting((0, 0, 0), (0.3 * pace, 0, 0)))
            return [kit.thing(wires, kit.plain(0.1, 0.2, 0.4), slow)]
        case "behind":  # the shadow of a bar runs behind a post that stands in front of it
            post = kit.thing(block((0.35, 2.2, 0.35)), _bright(dice), kit.standing(0.0, -0.6))
            bar = placed(capsule(1.6, 0.12), _lying((0, 1.6, 0.4)))
            slow = kit.following(kit.drifting((-_EVENT * pace * way, 0, 0), (pace * way, 0, 0)))
            return [post, kit.thing(bar, _bright(dice), slow)]
    return []


def _camera(dice: Dice, case: str) -> Camera:
    eye, target = np.array([0, 1.7, -3.4]), np.array([0, 0.5, 1.0])
    if case == "cut":  # to the other side of the stage

        def jumping(time: float) -> Floats:
            side = 1.6 if time > _EVENT - 0.5 else -1.6
            return look_at(eye + np.array([side, 0.3 * side, 0]), target)

        return Camera(jumping, 50)
    if case == "out_of_image":  # half of the image is new after five frames
        slide = dice.apart(0.3, 0.5) * dice.choice([-1, 1])
        start = np.array([-_EVENT * slide, 0, 0])
        return kit.camera(kit.drifting(eye + start, (slide, 0, 0)), kit.drifting(target + start, (slide, 0, 0)), 50)
    sway = 0.5 * (case in ("two_lobes", "curved_reflector"))
    return kit.camera(kit.swaying(eye, (sway, 0, 0), 0.25), kit.fixed(target), 50)


def _bright(dice: Dice) -> Pixels:
    return kit.textured(dice, kit.shades(dice.uniform(), 0.6, (0.9, 0.65, 0.4)), checker, stripes, dots)


def _lying(place: tuple[float, float, float]) -> Floats:
    """A hanging rod, turned to lie along z."""
    return np.asarray(translation(place) @ rotation((1, 0, 0), -np.pi / 2))
