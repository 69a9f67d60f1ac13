"""Meshes at rest: parametric surfaces with smooth normals, and faceted solids, all about one unit in radius."""

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import trimesh

from nte.render.world.scene import Mesh
from nte.render.world.transforms import Floats

Surface = Callable[[Floats, Floats], Floats]  # u, v in [0, 1], each (N,) → points (N, 3)


def parametric(surface: Surface, columns: int, rows: int) -> Mesh:
    """Make a smooth mesh from surface(u, v) on a grid of columns × rows; its uv are the parameters themselves.

    Seen from outside, u runs to the right where v runs up. Normals are finite differences, so a seam of the texture
    does not show in the shading.
    """
    u, v = (g.ravel() for g in np.meshgrid(np.linspace(0, 1, columns + 1), np.linspace(0, 1, rows + 1)))
    step = 1e-4
    inner_v = np.clip(v, step, 1 - step)  # at a pole the derivative along u vanishes, so it is taken beside the pole
    along_u = surface(u + step, inner_v) - surface(u - step, inner_v)
    along_v = surface(u, inner_v + step) - surface(u, inner_v - step)
    corner = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)).ravel()
    a, b, c, d = corner, corner + 1, corner + columns + 2, corner + columns + 1
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    return _mesh(surface(u, v), np.cross(along_u, along_v), np.stack([u, v], 1), faces)


def faceted(solid: trimesh.Trimesh, texture_size: float = 2.0) -> Mesh:
    """Make a mesh with flat faces from any trimesh, textured along the axis that each face looks to.

    texture_size: scene units that one period of the texture covers.
    """
    corners = np.asarray(solid.vertices, float)[np.asarray(solid.faces)]  # (F, 3, 3)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    side = np.abs(normals).argmax(1)
    across = np.array([[1, 2], [0, 2], [0, 1]])[side]  # the two axes that span the face
    uv = np.take_along_axis(corners, across[:, None, :].repeat(3, 1), 2) / texture_size
    faces = np.arange(3 * len(corners)).reshape(-1, 3)
    return _mesh(corners.reshape(-1, 3), normals.repeat(3, 0), uv.reshape(-1, 2), faces)


def rectangle(corner: npt.ArrayLike, right: npt.ArrayLike, up: npt.ArrayLike, texture_size: float = 1.0) -> Mesh:
    """Make the rectangle corner + s·right + t·up for s, t in [0, 1], which faces right × up.

    texture_size: scene units that one period of the texture covers.
    """
    c, r, u = (np.asarray(x, float) for x in (corner, right, up))
    positions = np.stack([c, c + r, c + r + u, c + u])
    size = np.array([np.linalg.norm(r), np.linalg.norm(u)]) / texture_size
    uv = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * size
    return _mesh(positions, np.tile(np.cross(r, u), (4, 1)), uv, np.array([[0, 1, 2], [0, 2, 3]]))


def revolved(
    radius: Callable[[Floats], Floats], height: Callable[[Floats], Floats], columns: int = 40, rows: int = 24
) -> Mesh:
    """Make a surface of revolution: the profile (radius(v), height(v)), from the bottom up, about the y axis."""

    def surface(u: Floats, v: Floats) -> Floats:
        angle = -2 * np.pi * u
        return np.stack([radius(v) * np.cos(angle), height(v), radius(v) * np.sin(angle)], 1)

    return parametric(surface, columns, rows)


def sphere() -> Mesh:
    """Make the unit sphere."""
    return revolved(lambda v: np.sin(np.pi * v), lambda v: -np.cos(np.pi * v))


def cylinder() -> Mesh:
    """Make a closed cylinder of radius 0.7 and height 2, with slightly rounded rims."""
    return revolved(lambda v: 0.7 * _squared(np.sin(np.pi * v)), lambda v: -_squared(np.cos(np.pi * v)), rows=40)


def vase(rng: np.random.Generator) -> Mesh:
    """Make a surface of revolution with a random wavy profile, closed at both ends."""
    waves, phase, depth = rng.uniform(0.8, 2.0), rng.uniform(0, 2 * np.pi), rng.uniform(0.15, 0.3)

    def radius(v: Floats) -> Floats:
        wavy = 0.6 + depth * np.sin(2 * np.pi * waves * v + phase)
        return np.asarray(np.sqrt(np.sin(np.pi * v).clip(0)) * wavy)

    return revolved(radius, lambda v: 2 * v - 1)


def torus(rng: np.random.Generator) -> Mesh:
    """Make a ring of radius 0.7 in the plane y = 0."""
    return tube(lambda u: _circle(u, 0.7), rng.uniform(0.22, 0.32))


def knot(rng: np.random.Generator) -> Mesh:
    """Make a trefoil or another torus knot."""
    turns, loops = [(2, 3), (3, 2), (2, 5)][rng.integers(3)]

    def curve(u: Floats) -> Floats:
        angle = 2 * np.pi * u
        ring = 0.62 + 0.25 * np.cos(loops * angle)
        return np.stack([ring * np.cos(turns * angle), 0.3 * np.sin(loops * angle), ring * np.sin(turns * angle)], 1)

    return tube(curve, 0.17, columns=128, rows=12)


def tube(curve: Callable[[Floats], Floats], radius: float, columns: int = 48, rows: int = 20) -> Mesh:
    """Make a tube about a closed curve(u) whose tangent is never vertical."""

    def surface(u: Floats, v: Floats) -> Floats:
        tangent = curve(u + 1e-3) - curve(u - 1e-3)
        side = _unit(np.cross(tangent, [0.0, 1.0, 0.0]))
        up = _unit(np.cross(side, tangent))
        angle = 2 * np.pi * v[:, None]
        return curve(u) + radius * (np.cos(angle) * side + np.sin(angle) * up)

    return parametric(surface, columns, rows)


def boulder(rng: np.random.Generator) -> Mesh:
    """Make a sphere that is displaced by a few smooth random waves."""
    directions = _unit(rng.normal(size=(6, 3))) * rng.uniform(1.5, 4.0, (6, 1))
    phases = rng.uniform(0, 2 * np.pi, 6)

    def surface(u: Floats, v: Floats) -> Floats:
        angle, polar = -2 * np.pi * u, np.pi * v
        point = np.stack([np.sin(polar) * np.cos(angle), -np.cos(polar), np.sin(polar) * np.sin(angle)], 1)
        waves = np.sin(point @ directions.T + phases).mean(1, keepdims=True)
        return np.asarray(point * (0.85 + 0.35 * waves))

    return parametric(surface, 40, 26)


def box(rng: np.random.Generator) -> Mesh:
    """Make a box of random proportions."""
    return faceted(trimesh.creation.box(rng.uniform(0.8, 1.7, 3)))


def gem() -> Mesh:
    """Make an icosahedron."""
    return faceted(trimesh.creation.icosahedron())


def _circle(u: Floats, radius: float) -> Floats:
    angle = 2 * np.pi * u
    return radius * np.stack([np.cos(angle), np.zeros_like(angle), np.sin(angle)], 1)


def _squared(x: Floats) -> Floats:
    """A sine pushed towards a square wave, which turns a circle into a rounded square."""
    return np.asarray(np.tanh(4 * x) / np.tanh(4.0))


def _unit(vectors: Floats) -> Floats:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))


def _mesh(positions: Floats, normals: Floats, uv: Floats, faces: npt.NDArray[np.integer]) -> Mesh:
    return Mesh(
        positions.astype(np.float32), _unit(normals).astype(np.float32), uv.astype(np.float32), faces.astype(np.uint32)
    )
