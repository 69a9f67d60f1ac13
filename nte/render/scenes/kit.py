"""Parts that families share: paths, lights, grounds, cameras, and textures in chosen colours."""

import colorsys
from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt

from nte.render.scenes import shapes
from nte.render.scenes.patterns import PATTERNS, Pattern
from nte.render.scenes.solids import placed
from nte.render.world.scene import Camera, Colour, Material, Mesh, Pixels, SceneObject, Surface
from nte.render.world.transforms import Floats, Path3, Track, look_at, rotation, still, translation

Angle = Callable[[float], float]  # time in frames → radians
Height = Callable[[Floats, Floats], Floats]  # x, z (N,) → y (N,)
UP = (0.0, 1.0, 0.0)
DOWNWARDS = rotation((1, 0, 0), np.pi / 2)  # turns a panel to shine down
_LIGHT_ALBEDO = np.full((1, 1, 3), 0.8, np.float32)  # not dark, so that dividing by albedo keeps lights reasonable


def fixed(point: npt.ArrayLike) -> Path3:
    """Return a path that stays at a point (3,)."""
    where = np.asarray(point, float)
    return lambda time: where


def drifting(start: npt.ArrayLike, velocity: npt.ArrayLike) -> Path3:
    """Return a straight path: from `start` (3,) by `velocity` (3,) units per frame."""
    a, v = np.asarray(start, float), np.asarray(velocity, float)
    return lambda time: a + v * time


def swaying(middle: npt.ArrayLike, reach: npt.ArrayLike, rate: float, phase: float = 0.0) -> Path3:
    """Return a path to and fro: middle ± reach (3,), at `rate` radians per frame; fastest at phase 0."""
    a, r = np.asarray(middle, float), np.asarray(reach, float)
    return lambda time: a + r * np.sin(rate * time + phase)


def circling(middle: npt.ArrayLike, radius: float, rate: float, phase: float = 0.0) -> Path3:
    """Return a path round a vertical axis, at `rate` radians per frame."""
    a = np.asarray(middle, float)
    return lambda time: a + radius * np.array([np.cos(rate * time + phase), 0, np.sin(rate * time + phase)])


def following(path: Path3) -> Track:
    """Return a track that moves along a path without turning."""
    return lambda time: translation(path(time))


def aimed(path: Path3, target: npt.ArrayLike) -> Track:
    """Return a track along a path, with +z towards a point that must not be straight above or below."""
    return lambda time: look_at(path(time), target)


def standing(x: float, z: float, turn: float = 0.0, y: float = 0.0) -> Track:
    """Return a track that stands still at a place on the ground, turned by `turn` radians about the vertical."""
    return still(translation((x, y, z)) @ rotation(UP, turn))


def thing(mesh: Mesh, color: Pixels, track: Track, surface: Surface = "diffuse", roughness: float = 1.0) -> SceneObject:
    """Make an object of one material."""
    return SceneObject(mesh, Material(color, surface, roughness), track)


def panel(width: float, height: float, power: float, track: Track, colour: Colour = (1.0, 1.0, 1.0)) -> SceneObject:
    """Make a rectangular light that shines along its +z.

    power: radiance times area, so that the size changes nothing but the softness of shadows.
    """
    mesh = shapes.rectangle((-width / 2, -height / 2, 0), (width, 0, 0), (0, height, 0))
    return _light(mesh, power / (width * height), track, colour)


def bulb(radius: float, power: float, track: Track, colour: Colour = (1.0, 1.0, 1.0)) -> SceneObject:
    """Make a glowing ball. power: radiance times the area of its disc."""
    return _light(placed(shapes.sphere(), np.eye(4), radius), power / (np.pi * radius**2), track, colour)


def ground(
    width: float, depth: float, color: Pixels, surface: Surface = "diffuse", roughness: float = 1.0,
    texture_size: float = 4.0,
) -> SceneObject:  # fmt: skip
    """Make a rectangle at y = 0 that faces up, centred at the origin."""
    mesh = shapes.rectangle((-width / 2, 0, depth / 2), (width, 0, 0), (0, 0, -depth), texture_size)
    return thing(mesh, color, still(), surface, roughness)


def wall(
    start: tuple[float, float], end: tuple[float, float], height: float, color: Pixels, texture_size: float = 4.0
) -> SceneObject:
    """Make an upright rectangle between two points (x, z); `start` is on the left as one looks at its front."""
    across = (end[0] - start[0], 0.0, end[1] - start[1])
    return thing(shapes.rectangle((start[0], 0, start[1]), across, (0, height, 0), texture_size), color, still())


def sky(rng: np.random.Generator, sun: npt.ArrayLike, brightness: float = 1.0) -> Pixels:
    """Make an environment (64, 128, 3): blue above, pale at the horizon, earth below, a soft sun towards `sun` (3,)."""
    rows, columns = 64, 128
    polar, turn = np.pi * (np.arange(rows) + 0.5) / rows, 2 * np.pi * (np.arange(columns) + 0.5) / columns
    theta, phi = np.meshgrid(polar, turn, indexing="ij")
    direction = np.stack([np.sin(phi) * np.sin(theta), np.cos(theta), -np.cos(phi) * np.sin(theta)], axis=-1)
    up = direction[..., 1:2]
    zenith, horizon, earth = np.array([0.25, 0.45, 0.95]), np.array([0.9, 0.9, 0.85]), np.array([0.3, 0.25, 0.2])
    air = horizon + (zenith - horizon) * np.clip(up, 0, 1) ** rng.uniform(0.4, 0.7)
    towards = direction @ (np.asarray(sun, float) / np.linalg.norm(sun))
    glow = 150 * np.exp((towards - 1) / 0.006) + 1.5 * np.exp((towards - 1) / 0.05)
    haze = np.exp(-np.abs(up) / 0.06)
    light = np.where(up > 0, air, earth + haze * (horizon - earth)) + glow[..., None] * [1.0, 0.9, 0.7]
    return np.asarray(brightness * light, np.float32)


def camera(eye: Path3, target: Path3, fov: float) -> Camera:
    """Make a camera on a path that looks at a point on another path. fov: horizontal, degrees."""
    return Camera(lambda time: look_at(eye(time), target(time)), fov)


def shades(hue: float, saturation: float, values: Sequence[float] = (0.75, 0.5, 0.25)) -> Floats:
    """Make three colours (3, 3) of about one hue and of different lightness, linear."""
    hues = [hue, hue + 0.03, hue - 0.04]
    return np.array([colorsys.hsv_to_rgb(h % 1, saturation, v) for h, v in zip(hues, values, strict=True)])


def textured(rng: np.random.Generator, colours: Floats, *patterns: Pattern) -> Pixels:
    """Make a texture in these three colours (3, 3), by a random one of the patterns, or of all if none is given."""
    pattern = (patterns or PATTERNS)[rng.integers(len(patterns or PATTERNS))]
    return (pattern(rng) @ colours).astype(np.float32)


def plain(hue: float, saturation: float, value: float) -> Pixels:
    """Make a texture (1, 1, 3) of one colour."""
    return np.array(colorsys.hsv_to_rgb(hue % 1, saturation, value), np.float32).reshape(1, 1, 3)


def _light(mesh: Mesh, radiance: float, track: Track, colour: Colour) -> SceneObject:
    r, g, b = (radiance * component for component in colour)
    return SceneObject(mesh, Material(_LIGHT_ALBEDO), track, (r, g, b))
