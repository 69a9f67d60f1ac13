"""Frames of a slanted ground and a ball before the sky, ray-cast in closed form; the camera pans and travels."""

import numpy as np
import numpy.typing as npt

from tests.synthetic import Pixels, smooth_texture

SIZE = (64, 96)
FOCAL = 80.0  # px
GROUND, BALL = 1, 2
UP, RADIUS = np.array([0.1, 0.97, -0.2]), 1.0
UP = UP / np.linalg.norm(UP)

Floats = npt.NDArray[np.float64]


def camera(index: float) -> tuple[Floats, Floats]:
    """Place (3,) and rows right, up, forward (3, 3) of the camera in frame `index`."""
    pan, tilt = 0.35 + 0.02 * index, -0.25
    forward = np.array([np.sin(pan) * np.cos(tilt), np.sin(tilt), np.cos(pan) * np.cos(tilt)])
    right = np.array([np.cos(pan), 0.0, -np.sin(pan)])
    return np.array([0.15 * index, 1.6, 0.05 * index]), np.stack([right, np.cross(forward, right), forward])


def ball(index: float) -> Floats:
    """Centre (3,) of the ball."""
    return np.array([0.6 + 0.7 * index, 1.3, 4.5])


def seen(points: Floats, index: float) -> Floats:
    """Pixel positions (2, …) of world points (3, …)."""
    place, axes = camera(index)
    x, y, z = np.einsum("ij,j...->i...", axes, points - place.reshape(3, *[1] * (points.ndim - 1)))
    return np.stack([SIZE[1] / 2 + FOCAL * x / z, SIZE[0] / 2 - FOCAL * y / z])


def room_frame(index: float) -> dict[str, Pixels]:
    """Channels (C, H, W) of frame `index` in nte's conventions, `position` included; the sky has depth 0."""
    y, x = np.mgrid[: SIZE[0], : SIZE[1]] + 0.5
    place, axes = camera(index)
    ray = np.einsum("ji,jhw->ihw", axes, np.stack([(x - SIZE[1] / 2) / FOCAL, (SIZE[0] / 2 - y) / FOCAL, 0 * x + 1]))
    ground = -(place @ UP) / np.einsum("i,ihw->hw", UP, ray)
    ground = np.where((ground > 0) & (ground < 14), ground, np.inf)
    away = place - ball(index)
    half, square = np.einsum("i,ihw->hw", away, ray), (ray**2).sum(0)
    inner = half**2 - square * (away @ away - RADIUS**2)
    near = np.where(inner > 0, (-half - np.sqrt(np.maximum(inner, 0))) / square, np.inf)
    depth = np.minimum(ground, near)
    hit, is_ball = np.isfinite(depth), near < ground
    position = place.reshape(3, 1, 1) + np.where(hit, depth, 1) * ray
    normal = np.where(is_ball, (position - ball(index).reshape(3, 1, 1)) / RADIUS, UP.reshape(3, 1, 1))
    before = position + np.where(is_ball, (ball(index - 1) - ball(index)).reshape(3, 1, 1), 0)
    sky = camera(index - 1)[0].reshape(3, 1, 1) + ray
    albedo = np.where(is_ball, smooth_texture(9 * normal[0], 9 * normal[1], 2.0), smooth_texture(*(9 * position[::2])))
    channels = {
        "color": albedo,
        "albedo": np.where(hit, albedo, 0),
        "normal": np.where(hit, normal, 0),
        "depth": np.where(hit, depth, 0)[None],
        "position": np.where(hit, position, 0),
        "instance": np.where(hit, np.where(is_ball, BALL, GROUND), 0)[None],
        "motion": seen(np.where(hit, before, sky), index - 1) - np.stack([x, y]),
    }
    return {name: values.astype(np.float32) for name, values in channels.items()}


def distances(frame: dict[str, Pixels]) -> Pixels:
    """The depth (1, H, W) of a frame measured from the camera instead of along the view axis."""
    y, x = np.mgrid[: SIZE[0], : SIZE[1]] + 0.5
    along = np.sqrt(1 + ((x - SIZE[1] / 2) / FOCAL) ** 2 + ((y - SIZE[0] / 2) / FOCAL) ** 2)
    return (frame["depth"] * along).astype(np.float32)
