"""Places on shapes of any kind: the point of the object at rest, with its normal and curvature there.

Objects move by transforms. A transform carries point, normal and curvature from the time at which a ray meets them to
rest (the object's place in the XML), and from rest to any other time.
"""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from nte.render.engine.backend import load_drjit, load_mitsuba
from nte.render.engine.places import Indices
from nte.render.engine.types import Hit, Interaction, Lanes, Ray
from nte.render.world.transforms import Floats, Track, transform_points

_POINT, _NORMAL, _CURVATURE = slice(0, 3), slice(3, 6), slice(6, 15)


class Rest:
    """Places (P, 15): point, unit normal, and row by row the normal's change with a step (3, 3)."""

    width = 15

    def __init__(self, tracks: Sequence[Track | None]) -> None:
        """Take each instance's track: its motion, added to its place in the XML; None for one that stays there."""
        self._tracks = tracks

    def columns(self, hit: Hit, ray: Ray) -> list[Lanes]:
        return self.columns_of(hit, ray, self.interaction(hit, ray))

    @staticmethod
    def interaction(hit: Hit, ray: Ray) -> Interaction:
        """Return the interaction that `columns_of` needs for a hit."""
        mi = load_mitsuba()
        return hit.compute_surface_interaction(ray, mi.RayFlags.All | mi.RayFlags.dNSdUV)

    def columns_of(self, hit: Hit, ray: Ray, si: Interaction) -> list[Lanes]:
        """Return `columns` from an interaction that is known already; computing it is expensive with many shapes."""
        dr = load_drjit()
        met = hit.is_valid()
        curvature = dr.select(si.shape.is_mesh(), _of_triangle(hit, ray, si), _of_solid(si))
        bent = met & dr.all(dr.isfinite(curvature))
        return [*dr.select(met, si.p, 0), *dr.select(met, si.sh_frame.n, 0), *dr.select(bent, curvature, 0)]

    def stored(self, instance: Indices, columns: Floats, time: float) -> Floats:
        rest = columns.copy()
        for mine, track in self._moving(instance):
            rest[mine] = _carried(np.asarray(np.linalg.inv(track(time)), float), columns[mine])
        return rest

    def points(self, instance: Indices, place: Floats, time: float) -> Floats:
        points = place[:, _POINT].copy()
        for mine, track in self._moving(instance):
            points[mine] = transform_points(track(time), points[mine])
        return points

    def normals(self, instance: Indices, place: Floats, time: float) -> Floats:
        return self._at(instance, place, time)[:, _NORMAL]

    def curvatures(self, instance: Indices, place: Floats, time: float) -> Floats:
        return self._at(instance, place, time)[:, _CURVATURE].reshape(-1, 3, 3)

    def moved(self, instance: Indices, points: Floats, time: float, other: float) -> Floats:
        moved = points.copy()
        for mine, track in self._moving(instance):
            moved[mine] = transform_points(track(other) @ np.linalg.inv(track(time)), points[mine])
        return moved

    def _at(self, instance: Indices, place: Floats, time: float) -> Floats:
        there = place.copy()
        for mine, track in self._moving(instance):
            there[mine] = _carried(track(time), place[mine])
        return there

    def _moving(self, instance: Indices) -> list[tuple[npt.NDArray[np.bool_], Track]]:
        """The rows of each moving object, and its track."""
        numbers = np.unique(instance[instance > 0])
        tracks = [(number, self._tracks[number - 1]) for number in numbers]
        return [(instance == number, track) for number, track in tracks if track is not None]


def _carried(matrix: Floats, place: Floats) -> Floats:
    """Places after a 4×4 transform M.

    n' = M⁻ᵀ n / |M⁻ᵀ n|, and its change C' = (1 − n'n'ᵀ) M⁻ᵀ C M⁻¹ / |M⁻ᵀ n|.
    """
    inverse = np.linalg.inv(matrix[:3, :3])
    normal = place[:, _NORMAL] @ inverse
    length = np.maximum(np.linalg.norm(normal, axis=1), 1e-30)[:, None]
    normal /= length
    change = inverse.T @ place[:, _CURVATURE].reshape(-1, 3, 3) @ inverse / length[:, None]
    change -= normal[:, :, None] * (normal[:, None] @ change)
    return np.concatenate([transform_points(matrix, place[:, _POINT]), normal, change.reshape(-1, 9)], axis=1)


def _of_triangle(hit: Hit, ray: Ray, si: Interaction) -> Lanes:
    """Curvature (9,) of a triangle's shading normals; 0 without shading normals.

    Computed from the triangle's corners, which a hit with their barycentrics gives, also in instances. Mitsuba's own
    derivatives do not fit together here: it differentiates the normal by barycentrics and the point by texture
    coordinates.
    """
    mi, dr = load_mitsuba(), load_drjit()

    def corner(u: float, v: float) -> Interaction:
        there: Hit = mi.PreliminaryIntersection3f(hit)
        there.prim_uv = mi.Point2f(u, v)
        return there.compute_surface_interaction(ray)

    a, b, c = (corner(*place) for place in ((0, 0), (1, 0), (0, 1)))
    u, v = hit.prim_uv
    length = dr.norm((1 - u - v) * a.sh_frame.n + u * b.sh_frame.n + v * c.sh_frame.n)
    turns = (b.sh_frame.n - a.sh_frame.n) / length, (c.sh_frame.n - a.sh_frame.n) / length
    return _change(turns, (b.p - a.p, c.p - a.p), si.sh_frame.n)


def _of_solid(si: Interaction) -> Lanes:
    """Curvature (9,) of a sphere, a cylinder or a plane, from Mitsuba's derivatives of point and normal."""
    return _change((si.dn_du, si.dn_dv), (si.dp_du, si.dp_dv), si.sh_frame.n)


def _change(turns: tuple[Lanes, Lanes], steps: tuple[Lanes, Lanes], normal: Lanes) -> Lanes:
    """The matrix (9,) that maps two steps along a surface to two turns of its normal, which stays a unit vector."""
    mi, dr = load_mitsuba(), load_drjit()
    first, second = (mi.Vector3f(step) for step in steps)
    across = dr.cross(first, second)
    area = dr.squared_norm(across)
    dual = dr.cross(second, across) / area, dr.cross(across, first) / area
    flat = [mi.Vector3f(turn) - normal * dr.dot(normal, turn) for turn in turns]
    rows = [sum(turn[i] * along[j] for turn, along in zip(flat, dual, strict=True)) for i in range(3) for j in range(3)]
    return mi.ArrayXf(rows)
