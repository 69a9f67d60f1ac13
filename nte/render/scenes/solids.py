"""Solids to build scenes from, in scene units: blocks, limbs, sheets, turned pieces, and functions that combine them.

Pieces for the ground stand on y = 0 at rest.
"""

from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt
import trimesh

from nte.render.scenes.shapes import faceted, parametric, rectangle, revolved
from nte.render.world.scene import Mesh
from nte.render.world.transforms import Floats, transform_points, translation

Size = tuple[float, float, float]


def block(size: Size, at: npt.ArrayLike = (0, 0, 0), texture_size: float = 2.0) -> Mesh:
    """Make a box of this width (x), height (y) and depth (z) that stands at `at`."""
    box = trimesh.creation.box(size, transform=translation((0, size[1] / 2, 0)))
    return placed(faceted(box, texture_size), translation(at))


def cushion(size: Size, rounding: float, at: npt.ArrayLike = (0, 0, 0), texture_size: float = 1.5) -> Mesh:
    """Make a box with rounded edges that stands at `at`. rounding: edge radius, at most half of the smallest side."""
    box = trimesh.creation.box((2, 2, 2)).subdivide().subdivide().subdivide()
    directions = np.sign(box.vertices) * np.abs(box.vertices) ** 0.25  # moves the vertices towards the edges
    inner = np.array(size) / 2 - rounding
    core = np.clip(directions * np.array(size) / 2, -inner, inner)
    outward = directions * np.array(size) / 2 - core
    outward /= np.maximum(np.linalg.norm(outward, axis=1, keepdims=True), 1e-9)
    solid = trimesh.Trimesh(core + rounding * outward + (0, size[1] / 2, 0), box.faces, process=False)
    flat = faceted(solid, texture_size)
    normals = outward[np.asarray(box.faces)].reshape(-1, 3).astype(np.float32)
    return placed(Mesh(flat.positions, normals, flat.uv, flat.faces), translation(at))


def capsule(length: float, radius: float) -> Mesh:
    """Make a limb that hangs from the origin: a rod with round ends, from y = 0 to y = −length."""
    bend = radius / (length + 2 * radius)  # the share of the profile's height that each round end takes

    def profile(v: Floats) -> tuple[Floats, Floats]:
        low, high = np.minimum(v / (2 * bend), 0.5), np.maximum((v - 1) / (2 * bend) + 1, 0.5)
        angle = np.pi * (low + high - 0.5)
        middle = np.clip((v - bend) / (1 - 2 * bend), 0, 1)
        return radius * np.sin(angle), -radius * np.cos(angle) - length * (1 - middle)

    return revolved(lambda v: profile(v)[0], lambda v: profile(v)[1], columns=24, rows=32)


def turned(profile: npt.ArrayLike, columns: int = 40, rows: int = 48) -> Mesh:
    """Make a surface of revolution from points (radius, height), (N, 2), bottom up, joined by a smooth line."""
    points = np.asarray(profile, float)
    steps = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    tangents = np.gradient(points, steps, axis=0)

    def along(v: Floats, axis: int) -> Floats:
        """Cubic Hermite interpolation by arc length."""
        s = np.clip(v, 0, 1) * steps[-1]
        i = np.clip(np.searchsorted(steps, s, side="right") - 1, 0, len(steps) - 2)
        width = steps[i + 1] - steps[i]
        t = (s - steps[i]) / width
        p, q = points[i, axis], points[i + 1, axis]
        from_p, to_q = tangents[i, axis] * width, tangents[i + 1, axis] * width
        value = (1 + 2 * t) * (1 - t) ** 2 * p + t * (1 - t) ** 2 * from_p
        return np.asarray(value + t * t * (3 - 2 * t) * q + t * t * (t - 1) * to_q)

    # A radius of exactly 0 has no normal, and the line may dip below 0 between two points on the axis.
    return revolved(lambda v: np.maximum(along(v, 0), 1e-5), lambda v: along(v, 1), columns, rows)


def sheet(
    width: float, depth: float, height: Callable[[Floats, Floats], Floats], texture_size: float = 2.0, cells: int = 96
) -> Mesh:
    """Make a cloth or relief that faces up, centred at the origin: height(x, z) for x in ±width/2, z in ±depth/2."""

    def surface(u: Floats, v: Floats) -> Floats:
        x, z = (u - 0.5) * width, (0.5 - v) * depth
        return np.stack([x, height(x, z), z], 1)

    mesh = parametric(surface, cells, cells)
    return Mesh(mesh.positions, mesh.normals, mesh.uv * np.array([width, depth], np.float32) / texture_size, mesh.faces)


def framed(
    corner: npt.ArrayLike,
    right: npt.ArrayLike,
    up: npt.ArrayLike,
    hole: tuple[float, float, float, float],
    texture_size: float = 4.0,
) -> Mesh:
    """Make a rectangle (see shapes.rectangle) with an opening: left, right, bottom, top, as shares of its sides."""
    c, r, u = (np.asarray(x, float) for x in (corner, right, up))
    left, end, bottom, top = hole
    parts = [(0.0, left, 0.0, 1.0), (end, 1.0, 0.0, 1.0), (left, end, 0.0, bottom), (left, end, top, 1.0)]
    return merged(
        [rectangle(c + s0 * r + t0 * u, (s1 - s0) * r, (t1 - t0) * u, texture_size) for s0, s1, t0, t1 in parts]
    )


def placed(mesh: Mesh, matrix: Floats, scale: float | Size = 1.0, texture: float | None = None) -> Mesh:
    """Return the mesh scaled and then moved by a rigid 4×4. texture: factor on uv."""
    scales = np.broadcast_to(np.asarray(scale, float), 3)
    normals = mesh.normals / scales @ matrix[:3, :3].T
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    positions = transform_points(matrix, mesh.positions * scales)
    uv = mesh.uv if texture is None else mesh.uv * np.float32(texture)
    return Mesh(positions.astype(np.float32), normals.astype(np.float32), uv, mesh.faces)


def merged(meshes: Sequence[Mesh]) -> Mesh:
    """Return several meshes as one, for parts of one material that move together."""
    starts = np.cumsum([0, *(len(mesh.positions) for mesh in meshes[:-1])])
    return Mesh(
        np.concatenate([mesh.positions for mesh in meshes]),
        np.concatenate([mesh.normals for mesh in meshes]),
        np.concatenate([mesh.uv for mesh in meshes]),
        np.concatenate([mesh.faces + np.uint32(start) for mesh, start in zip(meshes, starts, strict=True)]),
    )
