"""Rigid transforms, and tracks that say where something is at a time.

Matrices are 4×4 float64 on column vectors, object → world. The world has y up. Times are in frames and may be
fractional or negative: motion needs the frame before the first and the frame after the last, motion blur the times in
between.
"""

from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Track = Callable[[float], Floats]  # time in frames → 4×4, object → world
Path3 = Callable[[float], Floats]  # time in frames → point (3,)


def translation(offset: npt.ArrayLike) -> Floats:
    """Return the 4×4 matrix that moves by `offset` (3,)."""
    matrix = np.eye(4)
    matrix[:3, 3] = offset
    return matrix


def rotation(axis: npt.ArrayLike, angle: float) -> Floats:
    """Return the 4×4 that turns by `angle` radians about `axis` (3,), counter-clockwise seen against the axis."""
    x, y, z = np.asarray(axis, float) / np.linalg.norm(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    matrix = np.eye(4)
    matrix[:3, :3] += np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    return matrix


def look_at(eye: npt.ArrayLike, target: npt.ArrayLike, up: Sequence[float] | Floats = (0.0, 1.0, 0.0)) -> Floats:
    """Return camera → world, 4×4, in Mitsuba's convention.

    The camera looks along +z; +x is to its left, +y towards `up`.
    """
    origin = np.asarray(eye, float)
    forward = np.asarray(target, float) - origin
    forward /= np.linalg.norm(forward)
    left = np.cross(up, forward)
    left /= np.linalg.norm(left)
    matrix = np.eye(4)
    matrix[:3] = np.stack([left, np.cross(forward, left), forward, origin], axis=1)
    return matrix


def still(matrix: Floats | None = None) -> Track:
    """Return a track that does not move; the identity if no 4×4 matrix is given."""
    fixed = np.eye(4) if matrix is None else matrix
    return lambda time: fixed


def moving(path: Path3, axis: npt.ArrayLike, spin: float, phase: float = 0.0) -> Track:
    """Return a track along a path that turns about `axis` by `spin` radians per frame, from `phase` at time 0."""
    return lambda time: translation(path(time)) @ rotation(axis, phase + spin * time)


def attached(parent: Track, child: Track) -> Track:
    """Return the track of something that moves by `child` within `parent`, such as an arm on a shoulder."""
    return lambda time: parent(time) @ child(time)


def transform_points(matrix: Floats, points: npt.NDArray[np.floating]) -> Floats:
    """Apply a 4×4 to points (N, 3)."""
    return points @ matrix[:3, :3].T + matrix[:3, 3]


def transform_directions(matrix: Floats, directions: npt.NDArray[np.floating]) -> Floats:
    """Apply the rotation of a rigid 4×4 to directions (N, 3)."""
    return directions @ matrix[:3, :3].T
