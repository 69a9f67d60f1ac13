"""Rooms: textured walls, moving objects that hide and uncover them, a moving camera, area lights.

Scene units are about metres, y is up. The room spans x in ±width/2, y in [0, height], z in [0, depth]; the camera
stands near z = 0 and looks along +z. Speeds suit images of 128 pixels: objects move by several pixels per frame, and
the camera moves the background by one to three.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from nte.render.scenes import shapes
from nte.render.scenes.daylight import let_daylight_in
from nte.render.scenes.family import switch
from nte.render.scenes.patterns import plain, random_texture
from nte.render.world.scene import Camera, Colour, Material, Mesh, Scene, SceneObject
from nte.render.world.transforms import Floats, Path3, Track, look_at, moving, rotation, still, translation

_LIGHT_ALBEDO = np.full((1, 1, 3), 0.8, np.float32)  # not dark, so that dividing by albedo keeps lights reasonable
_OBJECTS = 15  # the same in every room: Dr.Jit's kernels depend on the number, and compiling takes 0.6 s
_UP = (0.0, 1.0, 0.0)


@dataclass(frozen=True)
class _Room:
    width: float
    height: float
    depth: float


@dataclass
class Parameters:
    """window: whether sun and sky shine in through an opening in a side wall; one of the objects is then glass."""

    window: bool = switch(False)


def make_room(rng: np.random.Generator, parameters: Parameters) -> Scene:
    """Make a random room with walls, furniture, moving objects, lights and a camera."""
    room = _Room(rng.uniform(5.0, 7.0), rng.uniform(3.2, 4.2), rng.uniform(6.0, 8.0))
    objects = [*_walls(room, rng), *_lights(room, rng), *_movers(room, rng)]
    objects += _furniture(room, rng, _OBJECTS - len(objects))
    camera = _camera(room, rng)
    size = room.width, room.height, room.depth
    return let_daylight_in(size, rng, objects, camera) if parameters.window else Scene(tuple(objects), camera)


def _walls(room: _Room, rng: np.random.Generator) -> list[SceneObject]:
    """Six inward-facing rectangles. Floor and walls are textured, the floor sometimes glossy."""
    w, h, d = room.width, room.height, room.depth
    x, y, z = (w, 0, 0), (0, h, 0), (0, 0, d)
    left, right = -w / 2, w / 2
    sides = {
        "back": ((right, 0, d), (-w, 0, 0), y),
        "left": ((left, 0, d), (0, 0, -d), y),
        "right": ((right, 0, 0), z, y),
        "front": ((left, 0, 0), x, y),
        "ceiling": ((left, h, 0), x, z),
        "floor": ((left, 0, d), x, (0, 0, -d)),
    }
    walls = []
    for name, (corner, across, up) in sides.items():
        mesh = shapes.rectangle(corner, across, up, texture_size=rng.uniform(3.5, 5.5))
        if name == "ceiling":
            material = Material(np.full((1, 1, 3), rng.uniform(0.6, 0.85), np.float32))
        elif name == "floor" and rng.uniform() < 0.4:
            material = Material(random_texture(rng), "glossy", rng.uniform(0.25, 0.5))
        else:
            material = Material(random_texture(rng))
        walls.append(SceneObject(mesh, material, still()))
    return walls


def _furniture(room: _Room, rng: np.random.Generator, count: int) -> list[SceneObject]:
    """Objects that stand still, for parallax."""
    return [
        _object(rng, still(translation(_place(room, rng, size)) @ rotation(_UP, rng.uniform(0, 6))), size)
        for size in rng.uniform(0.4, 0.8, count)
    ]


def _movers(room: _Room, rng: np.random.Generator) -> list[SceneObject]:
    """Objects that sweep, circle, bounce and tumble; at least one is glossy and one is metal."""
    count = int(rng.integers(4, 7))
    surfaces = ["glossy", "metal", *rng.choice(["diffuse", "diffuse", "glossy", "metal"], count - 2)]
    movers = []
    for surface in surfaces:
        size = rng.uniform(0.35, 0.7)
        path = _PATHS[rng.integers(len(_PATHS))](room, rng, size)
        axis = rng.normal(size=3)
        track = moving(path, axis, rng.uniform(-0.15, 0.15), rng.uniform(0, 6))
        movers.append(_object(rng, track, size, surface))
    return movers


def _object(rng: np.random.Generator, track: Track, size: float, surface: str | None = None) -> SceneObject:
    kind = _SHAPES[rng.integers(len(_SHAPES))]
    return SceneObject(_scaled(kind(rng), size), _material(rng, surface), track)


def _material(rng: np.random.Generator, surface: str | None) -> Material:
    color = random_texture(rng) if rng.uniform() < 0.8 else plain(rng)
    if surface == "metal":
        return Material(0.35 + 0.6 * color, "metal", rng.uniform(0.15, 0.5))  # real metals reflect most light
    if surface == "glossy":
        return Material(color, "glossy", rng.uniform(0.15, 0.5))
    return Material(color)


def _place(room: _Room, rng: np.random.Generator, size: float) -> Floats:
    """A point where an object of radius `size` is inside the room and out of the camera's way."""
    low = np.array([-room.width / 2 + size, size, 2.6])
    high = np.array([room.width / 2 - size, min(room.height - size - 0.3, 2.2), room.depth - size])
    return rng.uniform(low, np.maximum(high, low + 0.1))


def _sweep(room: _Room, rng: np.random.Generator, size: float) -> Path3:
    """A path to and fro across the view, at some 0.15 to 0.35 units per frame where it is fastest."""
    middle = _place(room, rng, size) * (0.2, 1, 1)
    reach = room.width / 2 - size - 0.2 * abs(middle[0]) - 0.1
    rate, phase = rng.uniform(0.15, 0.35) / reach, rng.uniform(0, 2 * np.pi)
    return lambda time: middle + np.array([reach * np.sin(rate * time + phase), 0, 0])


def _circle(room: _Room, rng: np.random.Generator, size: float) -> Path3:
    """A path round a vertical axis in the middle of the room, in either direction."""
    radius = rng.uniform(0.7, min(room.width, room.depth - 2.6) / 2 - size)
    middle = np.array([0, _place(room, rng, size)[1], (room.depth + 2.6 - size) / 2])
    rate, phase = rng.choice([-1, 1]) * rng.uniform(0.12, 0.3) / radius, rng.uniform(0, 2 * np.pi)
    return lambda time: middle + radius * np.array([np.cos(rate * time + phase), 0, np.sin(rate * time + phase)])


def _bounce(room: _Room, rng: np.random.Generator, size: float) -> Path3:
    """A path up and down on the spot, with a slow drift sideways."""
    ground = _place(room, rng, size) * (0.6, 0, 1) + (0, size, 0)
    jump = min(room.height - 2 * size - 0.3, 2.0)
    rate, drift, phase = rng.uniform(0.12, 0.22), rng.uniform(-0.06, 0.06), rng.uniform(0, np.pi)
    return lambda time: ground + np.array([drift * time, jump * abs(np.sin(rate * time + phase)), 0])


def _lights(room: _Room, rng: np.random.Generator) -> list[SceneObject]:
    """One to three area lights: ceiling panels, a panel on a side wall, a lamp that moves."""
    lights = [_ceiling_panel(room, rng)]
    if rng.uniform() < 0.5:
        lights.append(_side_panel(room, rng))
    if rng.uniform() < 0.5:
        lights.append(_lamp(room, rng))
    return lights


def _ceiling_panel(room: _Room, rng: np.random.Generator) -> SceneObject:
    """A large panel facing down, sometimes gliding along the ceiling."""
    width, length = rng.uniform(1.2, 2.4, 2)
    mesh = shapes.rectangle((-width / 2, 0, -length / 2), (width, 0, 0), (0, 0, length))
    middle = np.array([rng.uniform(-1, 1), room.height - 0.06, rng.uniform(2.2, room.depth - 2.0)])
    swing, rate = rng.choice([0.0, 0.0, 0.8]), rng.uniform(0.1, 0.25)

    def glide(time: float) -> Floats:
        return np.asarray(middle + np.array([swing * np.sin(rate * time), 0, 0]))

    return _light(mesh, moving(glide, _UP, 0.0), rng, 30.0 / (width * length))


def _side_panel(room: _Room, rng: np.random.Generator) -> SceneObject:
    """A window-like panel on the left or right wall."""
    width, height = rng.uniform(1.0, 2.0), rng.uniform(0.8, 1.5)
    side = rng.choice([-1.0, 1.0])
    x = side * (room.width / 2 - 0.05)
    y, z = rng.uniform(0.8, room.height - height - 0.2), rng.uniform(1.5, room.depth - 2.5)
    mesh = shapes.rectangle((x, y, z + (side < 0) * width), (0, 0, side * width), (0, height, 0))
    return _light(mesh, still(), rng, 12.0 / (width * height))


def _lamp(room: _Room, rng: np.random.Generator) -> SceneObject:
    """A glowing ball or ring that travels high through the room."""
    circle = _circle(room, rng, 0.5)
    mesh = _scaled(shapes.sphere() if rng.uniform() < 0.5 else shapes.torus(rng), rng.uniform(0.28, 0.4))

    def travel(time: float) -> Floats:
        x, _, z = circle(time)
        return np.array([x, room.height - 0.8, z])

    return _light(mesh, moving(travel, rng.normal(size=3), 0.1), rng, 7.0)


def _light(mesh: Mesh, track: Track, rng: np.random.Generator, radiance: float) -> SceneObject:
    tint = 1 + rng.uniform(-0.25, 0.25) * np.array([1.0, 0.1, -1.0])  # warm to cold
    r, g, b = (float(x) for x in radiance * tint * rng.uniform(0.7, 1.4))
    colour: Colour = (r, g, b)
    return SceneObject(mesh, Material(_LIGHT_ALBEDO), track, colour)


def _camera(room: _Room, rng: np.random.Generator) -> Camera:
    """A camera that dollies sideways, moves in or out, circles the middle or pans; most do several at once."""
    eye = np.array([rng.uniform(-0.7, 0.7), rng.uniform(1.2, 2.2), rng.uniform(0.6, 1.0)])
    target = np.array([rng.uniform(-0.6, 0.6), rng.uniform(1.0, 1.6), room.depth * 0.65])
    sway = np.array([rng.uniform(0.4, 1.1), rng.uniform(0.0, 0.3), rng.uniform(0.0, 0.4)])
    gaze = np.array([rng.uniform(0.3, 1.3), rng.uniform(0.0, 0.3), 0.0])
    rate, gaze_rate = rng.uniform(0.1, 0.18, 2) * rng.choice([-1, 1], 2)
    # The movement is fastest near phase 0; a clip that begins at a turning point would hardly move.
    phase, gaze_phase = rng.uniform(-0.8, 0.2, (2, 3)) * np.sign([[rate], [gaze_rate]])

    def track(time: float) -> Floats:
        return look_at(eye + sway * np.sin(rate * time + phase), target + gaze * np.sin(gaze_rate * time + gaze_phase))

    return Camera(track, rng.uniform(58, 74))


def _scaled(mesh: Mesh, size: float) -> Mesh:
    return Mesh(np.float32(size) * mesh.positions, mesh.normals, mesh.uv, mesh.faces)


_PATHS: tuple[Callable[[_Room, np.random.Generator, float], Path3], ...] = (_sweep, _sweep, _circle, _bounce)
_SHAPES: tuple[Callable[[np.random.Generator], Mesh], ...] = (
    lambda rng: shapes.sphere(), lambda rng: shapes.cylinder(), lambda rng: shapes.gem(),
    shapes.box, shapes.vase, shapes.torus, shapes.knot, shapes.boulder,
)  # fmt: skip
