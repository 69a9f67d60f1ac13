"""Anything anywhere: things of every shape and material, in a room or in the open, under lights of every kind.

The other families have a subject; this one has none, so that a network which is trained on it cannot learn one. All
that varies between scenes of the real world varies here, as widely as 128 pixels can show: shapes from boxes to leaves,
materials from black to mirror and glass, lights from a pin to a sky, from one to nine, speeds from rest to a tenth of
the image a frame.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from nte.render.scenes import kit, shapes
from nte.render.scenes.assortment import any_ground, any_material, any_mesh, tint
from nte.render.scenes.family import Dice, between, one_of
from nte.render.scenes.patterns import plain, random_texture
from nte.render.scenes.solids import placed
from nte.render.world.scene import Camera, Colour, Material, Pixels, Scene, SceneObject
from nte.render.world.transforms import Floats, Path3, Track, look_at, moving, rotation, still, translation

Surroundings = tuple[list[SceneObject], Colour | Pixels | None]  # walls and lights, and the light from outside


@dataclass
class Parameters:
    """things: how many, beside walls and lights. place: where they are. speed: of all that moves."""

    things: int = between(14, 1, 40)
    place: str = one_of("any", "room", "open", "studio")
    speed: float = between(1.0, 0.0, 4.0)


def make_jumble(dice: Dice, parameters: Parameters) -> Scene:
    """Make a scene of random things; half of its numbers are drawn from ranges that span a factor of ten."""
    place = parameters.place
    if place == "any":
        place = str(dice.choice(["room", "open", "studio"], p=[0.55, 0.3, 0.15]))
    reach = dice.apart(2.0, 3.6)  # the things are within this distance of the middle, (0, 1, 0)
    objects, outside = _PLACES[place](dice, reach)
    pace = parameters.speed * float(np.exp(dice.uniform(np.log(0.02), np.log(0.3))))
    objects += [_thing(dice, reach, pace) for _ in range(parameters.things)]
    return Scene(tuple(objects), _camera(dice, reach, parameters.speed), outside)


def _thing(dice: Dice, reach: float, pace: float) -> SceneObject:
    """A thing that lies, hangs or flies somewhere; every other one moves. pace: scene units per frame."""
    size = float(np.exp(dice.uniform(np.log(0.12), np.log(0.9))))
    angle, distance = dice.uniform(0, 2 * np.pi), reach * np.sqrt(dice.uniform())
    ground = dice.uniform() < 0.6
    height = size * 0.8 if ground else dice.uniform(size, 2.6)
    where = np.array([distance * np.cos(angle), height, distance * np.sin(angle)])
    turn, lean = dice.uniform(0, 6), dice.normal(size=3)
    rest = rotation(kit.UP, turn) if ground else rotation(lean, turn)
    mesh = placed(any_mesh(dice), rest, size)
    return SceneObject(mesh, any_material(dice), _track(dice, where, size, pace * dice.uniform(0.3, 1.5)))


def _track(dice: Dice, where: Floats, size: float, pace: float) -> Track:
    """At rest, along a line, on a circle, up and down, or turning on the spot. pace: scene units per frame."""
    kind = dice.choice(["rest", "line", "circle", "jump", "turn"], p=[0.5, 0.17, 0.13, 0.1, 0.1])
    phase = dice.uniform(0, 2 * np.pi)
    spin = dice.choice([0.0, 1.0], p=[0.4, 0.6]) * dice.uniform(-1, 1) * pace / size
    if kind == "rest":
        return still(translation(where))
    if kind == "turn":
        return moving(kit.fixed(where), kit.UP, pace / size * dice.choice([-1, 1]))
    if kind == "circle":
        radius = dice.uniform(0.4, 1.2)
        path = kit.circling(where - (radius, 0, 0), radius, pace / radius * dice.choice([-1, 1]), phase)
    elif kind == "jump":
        height, rate = dice.uniform(0.3, 1.2), pace / 0.8

        def path(time: float) -> Floats:
            return np.asarray(where + np.array([0, height * abs(np.sin(rate * time + phase)), 0]))
    else:
        way = dice.normal(size=3) * (1, 0.25, 1)
        extent = dice.uniform(0.5, 1.5)
        path = kit.swaying(where, extent * way / np.linalg.norm(way), pace / extent, phase)
    return moving(path, dice.normal(size=3), spin)


def _room(dice: Dice, reach: float) -> Surroundings:
    """Four walls, floor and ceiling, with lights inside; behind the camera too, which stands in the room."""
    half, height = reach + dice.uniform(0.8, 2.5), dice.uniform(2.6, 4.5)
    objects = [any_ground(dice, 2 * half, 2 * half)]
    corners = [(half, half), (-half, half), (-half, -half), (half, -half)]
    for (ax, az), (bx, bz) in zip(corners, corners[1:] + corners[:1], strict=True):
        paint = random_texture(dice) if dice.uniform() < 0.5 else plain(dice)
        objects.append(kit.wall((ax, az), (bx, bz), height, paint, dice.uniform(1.5, 6.0)))
    ceiling = shapes.rectangle((-half, height, -half), (2 * half, 0, 0), (0, 0, 2 * half))
    objects.append(SceneObject(ceiling, Material(np.full((1, 1, 3), dice.uniform(0.5, 0.9), np.float32)), still()))
    return objects + _lights(dice, half, height), None


def _open(dice: Dice, reach: float) -> Surroundings:
    """A wide ground under a sky; by night with lamps."""
    ground = [any_ground(dice, 60, 60)]
    if dice.uniform() < 0.25:
        lamps = _lights(dice, reach + 1, 4.0)
        r, g, b = tint(dice)
        return ground + lamps, (0.05 * r, 0.05 * g, 0.05 * b)
    sun = dice.normal(size=3) * (1, 0, 1) + (0, dice.uniform(0.2, 2.5), 0)
    return ground, kit.sky(dice, sun, float(np.exp(dice.uniform(np.log(0.5), np.log(3.0)))))


def _studio(dice: Dice, reach: float) -> Surroundings:
    """A ground with a wall behind it, a grey surrounding, and a few panels."""
    ground = any_ground(dice, 8 * reach, 8 * reach)
    back = kit.wall((3 * reach, reach + 1.5), (-3 * reach, reach + 1.5), 7, plain(dice))
    level = float(dice.uniform(0.02, 0.6))
    return [ground, back, *_lights(dice, reach + 0.5, 4.5)], (level, level, level)


def _lights(dice: Dice, half: float, height: float) -> list[SceneObject]:
    """One to nine lights of one total power: panels, bulbs or both, from a hand's breadth to metres in size.

    half, height: they hang within ±half of the middle, below this height.
    """
    count = int(dice.choice([1, 2, 3, 5, 9], p=[0.3, 0.3, 0.2, 0.1, 0.1]))
    shares = dice.dirichlet(np.full(count, 2.0))
    power = half**2 * float(np.exp(dice.uniform(np.log(0.5), np.log(8.0))))
    return [_light(dice, half, height, power * float(share)) for share in shares]


def _light(dice: Dice, half: float, height: float, power: float) -> SceneObject:
    x, z = dice.uniform(-0.85, 0.85, 2) * half
    y = height - dice.uniform(0.1, 0.9)
    middle = np.array([x, y, z])
    path: Path3 = kit.fixed(middle)
    if dice.uniform() < 0.2:  # swings
        path = kit.swaying(middle, dice.uniform(0.1, 0.5) * dice.normal(size=3) * (1, 0, 1), dice.uniform(0.05, 0.3))
    if dice.uniform() < 0.4:
        return kit.bulb(float(np.exp(dice.uniform(np.log(0.04), np.log(0.35)))), power, kit.following(path), tint(dice))
    sides = np.exp(dice.uniform(np.log(0.15), np.log(2.0), 2))
    downwards = dice.uniform() < 0.6
    target = middle - (dice.uniform(0.01, 0.3), 3, 0.1) if downwards else dice.uniform((-1, -0.2, -1), (1, 1.8, 1))
    return kit.panel(float(sides[0]), float(sides[1]), 4 * power, kit.aimed(path, target), tint(dice))


def _camera(dice: Dice, reach: float, speed: float) -> Camera:
    """A camera at rest, on a straight line, round the middle, turning, or held by hand; near or far, low or high."""
    angle = dice.uniform(-np.pi, np.pi)
    distance, height = reach + dice.uniform(0.2, 0.7), dice.uniform(0.5, 2.3)
    eye = np.array([distance * np.sin(angle), height, -distance * np.cos(angle)])
    target = dice.uniform((-0.8, 0.1, -0.8), (0.8, 1.7, 0.8))
    pace = speed * float(np.exp(dice.uniform(np.log(0.01), np.log(0.15))))  # scene units per frame
    kind = str(dice.choice(["rest", "line", "orbit", "turn", "hand"], p=[0.12, 0.3, 0.2, 0.18, 0.2]))
    aside = np.array([np.cos(angle), 0, np.sin(angle)]) * dice.choice([-1, 1])
    way = aside + dice.normal(size=3) * (0.3, 0.1, 0.3)
    shake = dice.normal(size=(2, 3)) * 0.6 * pace
    rates = dice.uniform(0.3, 1.1, (2, 3))

    def track(time: float) -> Floats:
        if kind == "line":
            return look_at(eye + pace * time * way * np.exp(-0.02 * abs(time)), target)
        if kind == "orbit":
            return look_at((rotation(kit.UP, pace / distance * time) @ np.append(eye, 1))[:3], target)
        if kind == "turn":
            return look_at(eye, target + distance * np.tan(np.clip(pace * time * 0.3, -1.2, 1.2)) * aside)
        if kind == "hand":
            a, b = (shake * np.sin(rates * time)).astype(float)
            return look_at(eye + a, target + 2 * b)
        return look_at(eye, target)

    camera = Camera(track, dice.uniform(38, 82))
    if dice.uniform() < 0.08:
        return replace(camera, aperture=dice.uniform(0.02, 0.08), focus=distance)
    return camera


_PLACES: dict[str, Callable[[Dice, float], Surroundings]] = {"room": _room, "open": _open, "studio": _studio}
