"""Places on surfaces: how a kernel names the place that a ray meets, and where that place is at any time.

The objects of a family may deform, so a place on them is a place on a triangle. The shapes of a user's own scene may
have no triangles, so a place on them is a point of the object at rest (nte.render.engine.xml.rest).
"""

from itertools import pairwise
from typing import Protocol

import numpy as np
import numpy.typing as npt

from nte.render.engine.types import Hit, Lanes, Ray
from nte.render.world.scene import Scene
from nte.render.world.transforms import Floats

Indices = npt.NDArray[np.int64]
_TIMES = 4  # how many times' vertices are cached; a frame repeatedly uses those of three times


class Places(Protocol):
    """Places (P, width) on objects; instances (P,) are the objects' numbers. 0 marks a miss; its place is ignored."""

    width: int

    def columns(self, hit: Hit, ray: Ray) -> list[Lanes]:
        """Return the place that a ray meets, as `width` Dr.Jit arrays; runs in the kernel."""

    def stored(self, instance: Indices, columns: Floats, time: float) -> Floats:
        """Return the places of `columns` (P, width), which a kernel returned at a time in frames."""

    def points(self, instance: Indices, place: Floats, time: float) -> Floats:
        """Return world points (P, 3) of places at a time in frames."""

    def normals(self, instance: Indices, place: Floats, time: float) -> Floats:
        """Return shading normals (P, 3) of places at a time in frames: world space, not of unit length."""

    def curvatures(self, instance: Indices, place: Floats, time: float) -> Floats:
        """Return the change of the unit shading normal with a step along the surface, (P, 3, 3), per scene unit.

        Positive where the surface bulges to the side of its normal; zero where it is flat, faceted or missed.
        """

    def moved(self, instance: Indices, points: Floats, time: float, other: float) -> Floats:
        """Carry world points (P, 3) along with their objects from `time` to `other`; points of instance 0 stay."""


class Triangles:
    """Places on meshes: the number of a triangle of the object, and the weights of its second and third vertex."""

    width = 3

    def __init__(self, scene: Scene) -> None:
        self._objects = scene.objects
        vertices = np.cumsum([0, *(len(obj.mesh.positions) for obj in scene.objects)])
        self._rows = [slice(*ends) for ends in pairwise(vertices)]  # each object's rows among all vertices
        meshes = [np.int64(first) + obj.mesh.faces for first, obj in zip(vertices, scene.objects, strict=False)]
        self._faces = np.concatenate([np.zeros((1, 3), np.int64), *meshes])  # (1 + F, 3); row 0 stands for a miss
        self._first_face = np.cumsum([0, 1, *map(len, meshes)])  # row of each instance's first face; a miss has row 0
        self._vertices: dict[float, tuple[Floats, Floats]] = {}

    def vertices(self, time: float) -> tuple[Floats, Floats]:
        """Return world positions and normals (V, 3) of all vertices at a time, object by object.

        The arrays are cached: do not write to them.
        """
        if time not in self._vertices:
            while len(self._vertices) >= _TIMES:
                self._vertices.pop(next(iter(self._vertices)))
            positions, normals = zip(*(obj.at(time) for obj in self._objects), strict=True)
            self._vertices[time] = np.concatenate(positions), np.concatenate(normals)
        return self._vertices[time]

    def vertices_of(self, instance: int, time: float) -> tuple[Floats, Floats]:
        """Return world positions and normals (V, 3) of one object's vertices at a time. instance: its number."""
        positions, normals = self.vertices(time)
        return positions[self._rows[instance - 1]], normals[self._rows[instance - 1]]

    def columns(self, hit: Hit, ray: Ray) -> list[Lanes]:
        return [hit.prim_index, *hit.prim_uv]

    def stored(self, instance: Indices, columns: Floats, time: float) -> Floats:
        return columns

    def points(self, instance: Indices, place: Floats, time: float) -> Floats:
        return self._interpolated(instance, place, self.vertices(time)[0])

    def normals(self, instance: Indices, place: Floats, time: float) -> Floats:
        return self._interpolated(instance, place, self.vertices(time)[1])

    def curvatures(self, instance: Indices, place: Floats, time: float) -> Floats:
        positions, normals = self.vertices(time)
        rows = self._corners(instance, place)
        normal = normals[rows]
        turned = normal[:, 1:] - normal[:, :1]
        result = np.zeros((len(rows), 3, 3))
        bent = (instance > 0) & (np.abs(turned).max((1, 2)) > 1e-6)
        edges = positions[rows[bent, 1:]] - positions[rows[bent, :1]]
        inner = place[bent, 1:]
        weight = np.concatenate([1 - inner.sum(1, keepdims=True), inner], 1)
        length = np.linalg.norm((weight[:, :, None] * normal[bent]).sum(1), axis=1)
        # The dual basis of the edges in the triangle's plane expresses a step in terms of the edges.
        first, second = edges[:, 0], edges[:, 1]
        across = np.cross(first, second)
        area = np.square(across).sum(1, keepdims=True) * length[:, None]
        dual = np.stack([np.cross(second, across), np.cross(across, first)], 1) / np.maximum(area, 1e-300)[:, :, None]
        result[bent] = turned[bent].transpose(0, 2, 1) @ dual
        return result

    def moved(self, instance: Indices, points: Floats, time: float, other: float) -> Floats:
        """Carry points along by the affine motion that fits the object's vertices best; exact for a rigid object."""
        moved = points.copy()
        for number in np.unique(instance[instance > 0]):
            now, then = (self.vertices_of(number, t)[0] for t in (time, other))
            middle = now.mean(0)
            if (now != then).any():
                turn = np.linalg.lstsq(now - middle, then - then.mean(0), rcond=1e-6)[0]
                mine = instance == number
                moved[mine] = (points[mine] - middle) @ turn + then.mean(0)
        return moved

    def _corners(self, instance: Indices, place: Floats) -> Indices:
        """The vertices (P, 3), as rows of `vertices`, of the triangles that the places are on."""
        triangle = np.where(instance > 0, place[:, 0], 0).astype(np.int64)
        triangle += self._first_face[instance]  # row 0 for a miss
        return np.asarray(self._faces.take(triangle, axis=0))

    def _interpolated(self, instance: Indices, place: Floats, vertices: Floats) -> Floats:
        a, b, c = self._corners(instance, place).T
        u, v = place[:, 1], place[:, 2]
        with np.errstate(invalid="ignore", over="ignore"):  # the weights of a miss are undefined
            w = 1 - u - v
            # Coordinate by coordinate: gathering and blending rows of three takes twice as long.
            columns = [w * column.take(a) + u * column.take(b) + v * column.take(c) for column in vertices.T]
        return np.stack(columns, axis=1)
