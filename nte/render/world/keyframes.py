"""Keyframes: a YAML file that says which XML scene is animated, and how its shapes, lights and camera move."""

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import numpy as np
from omegaconf import MISSING

from nte.config import load_config
from nte.errors import NteError, expected_one_of
from nte.render.world.transforms import Floats, Track, look_at, rotation, translation

INTERPOLATIONS = ("linear", "smooth")
_TRIES = 33  # times between two keyframes at which a scale is checked


@dataclass
class Key:
    """The place of an object or light in a frame, relative to its place in the XML: scaled, turned, then moved."""

    frame: float = MISSING
    translate: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])  # scene units
    rotate: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])  # degrees about x, then y, then z
    scale: list[float] = field(default_factory=lambda: [1.0, 1.0, 1.0])
    pivot: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])  # world point that turning and scaling keep
    brightness: float = 1.0  # of a light: factor on what the XML says


@dataclass
class CameraKey:
    """The place of the camera in a frame, and what it looks at; world space, scene units."""

    frame: float = MISSING
    origin: list[float] = MISSING
    target: list[float] = MISSING
    up: list[float] = field(default_factory=lambda: [0.0, 1.0, 0.0])


@dataclass
class Animation:
    """An XML scene and its motion."""

    xml: str = MISSING  # path, relative to the animation's file
    values: dict[str, str] = field(default_factory=dict)  # for the XML's <default> entries, by name
    interpolation: str = "linear"  # between keyframes: linear, or smooth (speed does not jump at keyframes)
    objects: dict[str, list[Key]] = field(default_factory=dict)  # by the id of a shape
    lights: dict[str, list[Key]] = field(default_factory=dict)  # by the id of an emitter that is not a shape
    camera: list[CameraKey] = field(default_factory=list)  # without keyframes it stays where the XML has it


def read_animation(path: Path) -> Animation:
    """Read and check an animation, and make `xml` a path that can be opened. Raises NteError naming the key."""
    animation = load_config(Animation, path)
    if animation.interpolation not in INTERPOLATIONS:
        wrong = animation.interpolation
        raise NteError(f"{path}: interpolation is '{wrong}'{expected_one_of(wrong, INTERPOLATIONS)}")
    for kind in ("objects", "lights"):
        for name, keys in getattr(animation, kind).items():
            _require_keys(f"{path}: {kind}.{name}", keys, ("translate", "rotate", "scale", "pivot"))
            _require_scales(f"{path}: {kind}.{name}", keys, animation.interpolation)
            for number, key in enumerate(keys):
                if not 0 <= key.brightness < np.inf:
                    where = f"{path}: {kind}.{name}[{number}]"
                    raise NteError(f"{where}.brightness is {key.brightness}: expected a number of at least 0")
    if animation.camera:
        _require_keys(f"{path}: camera", animation.camera, ("origin", "target", "up"))
        for number, view in enumerate(animation.camera):
            forward = np.subtract(view.target, view.origin)
            if np.linalg.norm(np.cross(forward, view.up)) < 1e-9 * max(1.0, float(np.linalg.norm(forward))):
                raise NteError(f"{path}: camera[{number}]: origin, target and up lie on one line")
    xml = path.parent / animation.xml
    if not os.path.isfile(xml):  # False also for a name that is too long for any file
        raise NteError(f"{path}: xml: {xml} is no file")
    animation.xml = str(xml)
    return animation


def moves(keys: Sequence[Key]) -> bool:
    """Say whether any keyframe puts the object elsewhere than the XML does."""
    return any(any(key.translate) or any(key.rotate) or {*key.scale} != {1} for key in keys)


def object_track(keys: Sequence[Key], interpolation: str) -> Track:
    """Return the 4×4 transform that keyframes add to a place in the XML, as a function of the time in frames."""
    move, turn, size, pivot = (
        _curve([key.frame for key in keys], [getattr(key, name) for key in keys], interpolation)
        for name in ("translate", "rotate", "scale", "pivot")
    )

    def track(time: float) -> Floats:
        x, y, z = np.radians(turn(time))
        about = pivot(time)
        turned = rotation((0, 0, 1), z) @ rotation((0, 1, 0), y) @ rotation((1, 0, 0), x)
        around = translation(about) @ turned @ np.diag([*size(time), 1.0]) @ translation(-about)
        return np.asarray(translation(move(time)) @ around)

    return track


def brightness_curve(keys: Sequence[Key], interpolation: str) -> Callable[[float], float] | None:
    """Return the factor on a light's brightness in the XML, as a function of the time in frames.

    None if no keyframe changes the brightness. The factor is never negative.
    """
    if all(key.brightness == 1 for key in keys):
        return None
    curve = _curve([key.frame for key in keys], [[key.brightness] for key in keys], interpolation)
    return lambda time: max(0.0, float(curve(time)[0]))  # a smooth curve may swing below its keyframes


def camera_track(keys: Sequence[CameraKey], interpolation: str) -> Track:
    """Return camera → world, 4×4, as a function of the time in frames."""
    origin, target, up = (
        _curve([key.frame for key in keys], [getattr(key, name) for key in keys], interpolation)
        for name in ("origin", "target", "up")
    )
    return lambda time: look_at(origin(time), target(time), up(time))


def _curve(frames: Sequence[float], values: Sequence[Sequence[float]], kind: str) -> Callable[[float], Floats]:
    """Values (K,) as a function of time, through the keyframes; constant before the first and after the last."""
    at, points = np.asarray(frames, float), np.asarray(values, float)
    if len(at) == 1:
        return lambda time: points[0]
    chords = np.diff(points, axis=0) / np.diff(at)[:, None]
    # Catmull-Rom slopes, for keyframes at any distance; 0 at both ends, because values are constant beyond them.
    slopes = np.zeros_like(points)
    slopes[1:-1] = (points[2:] - points[:-2]) / (at[2:] - at[:-2])[:, None]

    def curve(time: float) -> Floats:
        now = min(max(time, at[0]), at[-1])
        i = min(int(np.searchsorted(at, now, side="right")) - 1, len(at) - 2)
        width = at[i + 1] - at[i]
        t = (now - at[i]) / width
        if kind == "linear":
            return np.asarray(points[i] + chords[i] * (now - at[i]))
        start = (1 + 2 * t) * (1 - t) ** 2 * points[i] + t * (1 - t) ** 2 * width * slopes[i]
        return np.asarray(start + t**2 * (3 - 2 * t) * points[i + 1] - t**2 * (1 - t) * width * slopes[i + 1])

    return curve


def _require_scales(where: str, keys: Sequence[Key], interpolation: str) -> None:
    """Raise NteError for a scale of 0, in a keyframe or on the way between two keyframes."""
    for number, key in enumerate(keys):
        if 0 in key.scale:
            raise NteError(f"{where}[{number}].scale is {key.scale}: a transform with a scale of 0 is singular")
    curve = _curve([key.frame for key in keys], [key.scale for key in keys], interpolation)
    for number, (here, there) in enumerate(pairwise(keys)):
        way = np.array([curve(time) for time in np.linspace(here.frame, there.frame, _TRIES)])
        if (np.sign(way) != np.sign(way[0])).any():
            raise NteError(
                f"{where}[{number}].scale passes 0 on the way to the next keyframe, where it is singular: expected one "
                f"sign{', and smooth curves swing beyond their keyframes' if interpolation == 'smooth' else ''}"
            )


def _require_keys(where: str, keys: Sequence[Key | CameraKey], vectors: Sequence[str]) -> None:
    """Raise NteError for keyframes out of order and for vectors other than three finite numbers."""
    if not keys:
        raise NteError(f"{where} is empty: expected at least one keyframe")
    for number, key in enumerate(keys):
        if number and key.frame <= keys[number - 1].frame:
            before = keys[number - 1].frame
            raise NteError(f"{where}[{number}].frame is {key.frame:g} after {before:g}: expected a later one")
        for name in vectors:
            value = getattr(key, name)
            if len(value) != 3 or not np.isfinite(value).all():
                raise NteError(f"{where}[{number}].{name} is {value}: expected three numbers")
