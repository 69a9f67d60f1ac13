"""Curved reflectors: where they show a point, to second order in their shape.

A plane mirror shows a point at its mirror image; a curved one shows it nearer to its surface, and not equally near
along both principal directions: the thin lens that Zeng et al. 2021 leave to later work. Here the law of reflection
is solved on the quadric that has the surface's position, normal and curvature at a known point. NumPy float64.
"""

import numpy as np

from nte.render.transforms import Floats

_STEPS = 5  # of Newton's method, each of which turns the normal by _TURN radians at most
_TURN = 0.2
_REACH = 0.5  # radians: where the normal has turned by more, the quadric no longer is the surface
_MISSED = 0.01  # radians by which the normal may miss the half vector


def tangents(normal: Floats, first: Floats) -> Floats:
    """Two unit vectors (R, 3, 2) across unit normals (R, 3), one of them across `first` (R, 3) too."""
    # Head on, every direction across the normal is as good as any other.
    other = np.where(np.abs(normal[:, :1]) < 0.9, [[1.0, 0, 0]], [[0, 1.0, 0]])
    across = np.cross(normal, first + 1e-6 * other)
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-12)
    return np.stack([across, np.cross(normal, across)], 2)


def reflecting_points(point: Floats, normal: Floats, curvature: Floats, target: Floats, eye: Floats) -> Floats:
    """Where (R, 3) a surface mirrors targets (R, 3) to the eye (3,), near known points of it (R, 3), world.

    normal (R, 3) is unit and on the side of the eye, curvature (R, 3, 3) that of `rays.curvatures_at` for it. NaN where
    there is no such place near by: the normal would have to turn by more than half a radian.
    """
    frame = tangents(normal, eye - point)
    bend = within(frame, curvature)
    step = np.zeros((len(point), 2))
    for _ in range(_STEPS):
        place, facing = _quadric(point, normal, frame, bend, step)
        half, change = _half_vector(place, frame, target, eye)
        along = (half * facing).sum(1)
        missed = _in(frame, half - along[:, None] * facing)
        move = -solve(change - along[:, None, None] * bend, missed[:, :, None])[:, :, 0]
        turn = np.linalg.norm(np.einsum("rij,rj->ri", bend, move), axis=1)
        step += move * np.minimum(1, _TURN / np.maximum(turn, 1e-12))[:, None]
    place, facing = _quadric(point, normal, frame, bend, step)
    half, _ = _half_vector(place, frame, target, eye)
    cosine = (half * facing).sum(1) / np.maximum(np.linalg.norm(half, axis=1), 1e-12)
    turned = np.linalg.norm(np.einsum("rij,rj->ri", bend, step), axis=1)
    found = (cosine > np.cos(_MISSED)) & (turned < _REACH)
    return np.where(found[:, None], place, np.nan)


def solve(matrix: Floats, right: Floats) -> Floats:
    """x (R, 2, K) of matrix (R, 2, 2) · x = right (R, 2, K); large where the matrix is singular, never infinite."""
    a, b, c, d = matrix[:, 0, 0], matrix[:, 0, 1], matrix[:, 1, 0], matrix[:, 1, 1]
    determinant = a * d - b * c
    least = 1e-9 * np.maximum(np.square(matrix).sum((1, 2)), 1e-300)
    determinant = np.copysign(np.maximum(np.abs(determinant), least), determinant)
    inverse = np.stack([d, -b, -c, a], 1).reshape(-1, 2, 2) / determinant[:, None, None]
    return np.asarray(inverse @ right)


def _quadric(point: Floats, normal: Floats, frame: Floats, bend: Floats, step: Floats) -> tuple[Floats, Floats]:
    """Position and unit normal (R, 3) a step (R, 2) along the surface from its known point."""
    turn = np.einsum("rij,rj->ri", bend, step)
    place = point + np.einsum("rik,rk->ri", frame, step) - 0.5 * (step * turn).sum(1, keepdims=True) * normal
    facing = normal + np.einsum("rik,rk->ri", frame, turn)
    return place, facing / np.linalg.norm(facing, axis=1, keepdims=True)


def _half_vector(place: Floats, frame: Floats, target: Floats, eye: Floats) -> tuple[Floats, Floats]:
    """Sum (R, 3) of the unit vectors to target and eye, and its change (R, 2, 2) with steps in the frame."""
    total, change = np.zeros_like(place), np.zeros((len(place), 2, 2))
    for end in (target, eye):
        way = end - place
        distance = np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-9)
        way = way / distance
        total += way
        inside = _in(frame, way)
        change -= (np.eye(2) - inside[:, :, None] * inside[:, None, :]) / distance[:, :, None]
    return total, change


def _in(frame: Floats, vectors: Floats) -> Floats:
    """Components (R, 2) of vectors (R, 3) along the axes of frames (R, 3, 2)."""
    return np.stack([(frame[:, :, axis] * vectors).sum(1) for axis in (0, 1)], 1)


def within(frame: Floats, tensor: Floats) -> Floats:
    """The symmetric part (R, 2, 2) of a tensor (R, 3, 3) in the plane of a frame (R, 3, 2)."""
    inside = frame.transpose(0, 2, 1) @ tensor @ frame
    return np.asarray((inside + inside.transpose(0, 2, 1)) / 2)
