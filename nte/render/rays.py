"""Camera rays and what they meet, as NumPy rows: the same code for vectorised and scalar Mitsuba variants."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from nte.render.backend import is_scalar, load_drjit, load_mitsuba
from nte.render.stage import Stage
from nte.render.transforms import Floats

Indices = npt.NDArray[np.int64]
_RAYS = 1 << 22  # in flight at once: 4 M keep the pass under 1 GB


@dataclass(frozen=True)
class Hits:
    """What the rays through the pixel centres meet: one row per pixel, row by row."""

    instance: Indices  # (P,) 0 = miss, else index in scene.objects + 1
    triangle: Indices  # (P,)
    barycentric: Floats  # (P, 2), weights of the triangle's second and third vertex
    direction: Floats  # (P, 3), world: where a miss looks


@dataclass(frozen=True)
class Surfaces:
    """Sums (P, components) over the samples in each pixel, to which a sample that misses adds 0."""

    albedo: Floats
    normal: Floats
    roughness: Floats
    emission: Floats
    hit: Floats


def trace_centres(stage: Stage) -> Hits:
    """Hits of the rays through the pixel centres, at the time that `stage` is set to."""
    centre = np.full((1, 2), 0.5)
    shape, triangle, barycentric, direction = np.split(_trace(stage, centre, _intersect), [1, 2, 4], axis=1)
    return Hits(
        _instances(stage)[shape[:, 0].astype(np.int64)], triangle[:, 0].astype(np.int64), barycentric, direction
    )


def trace_surfaces(stage: Stage, offsets: Floats) -> Surfaces:
    """What is seen at `offsets` (S, 2) in every pixel, in [0, 1), at the time that `stage` is set to."""
    return Surfaces(*np.split(_trace(stage, offsets, _look), [3, 6, 7, 10], axis=1))


def _trace(stage: Stage, offsets: Floats, look: Callable[[Any, Any, Any], list[Any]]) -> Floats:
    """Values (P, K) of look(mi, scene, ray), summed over the rays at `offsets` (S, 2) in every pixel."""
    mi = load_mitsuba()
    pixels, samples = stage.width * stage.height, len(offsets)

    def values(x: Any, y: Any) -> list[Any]:
        ray, _ = stage.sensor.sample_ray(0.0, 0.5, mi.Point2f(x, y), mi.Point2f(0.5))
        return look(mi, stage.mi_scene, ray)

    rows = []
    step = max(1, _RAYS // samples)
    for start in range(0, pixels, step):
        index = np.arange(start, min(start + step, pixels))
        corner = np.stack([index % stage.width, index // stage.width], axis=1)
        film = (corner[:, None] + offsets).reshape(-1, 2) / (stage.width, stage.height)
        if is_scalar():
            table = np.array([values(x, y) for x, y in film.tolist()], float)
            rows.append(table.reshape(len(index), samples, -1).sum(1))
        else:
            columns = values(*(mi.Float(np.ascontiguousarray(column, np.float32)) for column in film.T))
            dr = load_drjit()
            dr.eval(columns)  # one kernel instead of one per column
            sums = columns if samples == 1 else [dr.block_sum(column, samples) for column in columns]
            rows.append(np.stack([np.array(column, float) for column in sums], axis=1))
    return np.concatenate(rows)


def _intersect(mi: Any, scene: Any, ray: Any) -> list[Any]:
    """Key of the shape (see _instances), triangle, two barycentric weights, direction (3)."""
    hit = scene.ray_intersect_preliminary(ray)
    return [_key(mi, hit.shape), hit.prim_index, hit.prim_uv.x, hit.prim_uv.y, *ray.d]


def _look(mi: Any, scene: Any, ray: Any) -> list[Any]:
    """albedo (3), normal (3), roughness, emission (3), hit: 0 where the ray misses."""
    si = scene.ray_intersect(ray)
    bsdf, emitter, hit = si.bsdf(), si.emitter(scene), si.is_valid()
    if is_scalar():
        emission = emitter.eval(si) if emitter else mi.Color3f(0)
        if not hit:
            return [0.0] * 7 + [*emission, 0.0]
        rough = bsdf.eval_attribute_1("roughness", si) if bsdf.has_attribute("roughness") else 1.0
        normal = si.sh_frame.n * (1 if si.wi.z >= 0 else -1)
        return [*bsdf.eval_diffuse_reflectance(si), *normal, rough, *emission, 1.0]
    dr = load_drjit()
    known = bsdf.has_attribute("roughness", hit)
    rough = dr.select(known, bsdf.eval_attribute_1("roughness", si, hit & known), 1)
    normal = dr.select(hit, si.sh_frame.n * dr.select(si.wi.z >= 0, 1, -1), 0)
    albedo = bsdf.eval_diffuse_reflectance(si, hit)  # the metals' specular colour too, in `principled`
    return [*albedo, *normal, dr.select(hit, rough, 0), *emitter.eval(si), dr.select(hit, mi.Float(1), 0)]


def _key(mi: Any, shape: Any) -> Any:
    """A whole number per shape: Dr.Jit's registry id, which is 1-based, in no fixed order; 0 for none."""
    if is_scalar():
        return int(shape.id().rsplit("_", 1)[1]) + 1 if shape else 0
    dr = load_drjit()
    return dr.reinterpret_array(mi.UInt32, shape)


def _instances(stage: Stage) -> Indices:
    """Table from keys of shapes to instance numbers: index in scene.objects + 1."""
    mi = load_mitsuba()
    scalar = is_scalar()
    keys = [int(_key(mi, m) if scalar else _key(mi, mi.ShapePtr(m))[0]) for m in stage.meshes.values()]
    table = np.zeros(max(keys) + 1, np.int64)
    table[keys] = np.arange(len(keys)) + 1
    return table
