"""Camera rays and what they meet, as NumPy rows: the same code for vectorised and scalar Mitsuba variants."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from nte.render.components.first_hit import camera_ray
from nte.render.components.lobes import Lobes
from nte.render.engine.arrays import to_jit, to_rows
from nte.render.engine.backend import is_scalar, load_drjit, load_mitsuba
from nte.render.engine.mesh_stage import Stage
from nte.render.world.transforms import Floats

Indices = npt.NDArray[np.int64]
_BEHIND = 1 + 1e-4  # along the ray itself: Mitsuba's spawn_ray steps sideways too
_GOLDEN = (5**0.5 - 1) / 2
_LOOK, _LOBES = 11, 6  # columns of Surfaces: always, and with those of the diffuse lobe


@dataclass(frozen=True)
class Hits:
    """What rays meet: one row per ray."""

    instance: Indices  # (P,) 0 = miss, else index in scene.objects + 1
    place: Floats  # (P, stage.places.width) where on it
    direction: Floats  # (P, 3), world: where a miss looks

    def of(self, rows: npt.NDArray[np.bool_] | Indices) -> "Hits":
        """The rays that `rows` selects: (P,) bool, or row numbers."""
        return Hits(self.instance[rows], self.place[rows], self.direction[rows])


@dataclass(frozen=True)
class Surfaces:
    """Sums (P, components) over the samples in each pixel, to which a sample that misses adds 0."""

    albedo: Floats
    normal: Floats
    roughness: Floats
    emission: Floats
    hit: Floats
    diffuse_albedo: Floats | None = None  # these two only where light components are rendered
    geometric_normal: Floats | None = None

    @staticmethod
    def of(rows: Floats) -> "Surfaces":
        """Split all columns side by side, (P, 11) or (P, 17), into the fields."""
        columns = np.split(rows, [3, 6, 7, 10, 11, 14], axis=1)
        return Surfaces(*columns if rows.shape[1] > _LOOK else columns[:5])


@dataclass(frozen=True)
class Seen:
    """What single camera rays meet: one row per ray; meaningless where `hit` is false."""

    point: Floats  # (R, 3) world
    normal: Floats  # (R, 3) shading normal, world
    roughness: Floats  # (R,) perceptual
    hit: npt.NDArray[np.bool_]  # (R,)
    hits: Hits


def trace_film(stage: Stage, pixel: Floats) -> Seen:
    """What is seen at pixel positions (R, 2), inside or outside the image; vectorised variants only."""
    film = [to_jit(load_mitsuba().Float, column) for column in (pixel / (stage.width, stage.height)).T]
    met, direction, *columns = stage.frozen(_film)(*film)
    hits = to_hits(stage, met, direction)
    point, normal, roughness, found = (np.array(column).T for column in columns)
    return Seen(point.astype(float), normal.astype(float), roughness.astype(float), found, hits)


def trace_centres(stage: Stage) -> Hits:
    """Hits of the rays through the pixel centres, at the time that `stage` is set to."""
    middle = np.full((1, 4), 0.5)
    rows = _trace_scalar(stage, middle, partial(_meet, stage)) if is_scalar() else to_rows(stage.frozen(_centres)())
    return _hits(stage, rows[:, :-3], rows[:, -3:])


def to_hits(stage: Stage, met: Sequence[Any], direction: Any) -> Hits:
    """The rows of what `Stage.met` says, evaluated, and of the directions (3,) that the rays had.

    `stage` must still be set to the time of the rays.
    """
    with np.errstate(invalid="ignore"):  # of a miss, whose barycentrics are whatever was in memory
        return _hits(stage, to_rows(met), np.array(direction, float).T)


def _hits(stage: Stage, met: Floats, direction: Floats) -> Hits:
    instance = stage.instances[met[:, 0].astype(np.int64)]
    return Hits(instance, stage.places.stored(instance, met[:, 1:]), direction)


def points_at(stage: Stage, hits: Hits, time: float) -> Floats:
    """Where the surface points of `hits` are at a time: (P, 3), world; the ray's direction for a miss.

    Whatever moves them, the stage says; a point at rest has exactly the same position at every time.
    """
    return np.where(hits.instance[:, None] > 0, stage.places.points(hits.instance, hits.place, time), hits.direction)


def normals_at(stage: Stage, hits: Hits, time: float) -> Floats:
    """Unit shading normals (P, 3) of `hits` at a time, outwards; the ray's direction for a miss."""
    normals = stage.places.normals(hits.instance, hits.place, time)
    normals = np.where(hits.instance[:, None] > 0, normals, hits.direction)
    return np.asarray(normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30))


def curvatures_at(stage: Stage, hits: Hits, time: float) -> Floats:
    """Curvatures (P, 3, 3) of the surfaces of `hits` at a time in frames: see Places.curvatures."""
    return stage.places.curvatures(hits.instance, hits.place, time)


def trace_surfaces(stage: Stage, offsets: Floats) -> Surfaces:
    """What is seen at `offsets` (S, 4), in [0, 1)⁴, at the time that `stage` is set to.

    The first two are a place in every pixel, the others one on the lens, where there is one: a half each is its middle.
    """
    if is_scalar():
        return Surfaces.of(_trace_scalar(stage, offsets, partial(_look, stage)))
    return Surfaces.of(to_rows(queue_surfaces(stage, offsets)))


def queue_surfaces(stage: Stage, offsets: Floats, lobes: bool = False) -> list[Any]:
    """The columns of Surfaces, Dr.Jit arrays (P,), which the kernel's own loop sums: queued, not waited for.

    lobes: with diffuse_albedo and geometric_normal.
    """
    mi, dr = load_mitsuba(), load_drjit()
    places = [to_jit(mi.Float, column) for column in offsets.T]
    return list(stage.frozen(_surfaces_and_lobes if lobes else _surfaces)(dr.opaque(mi.UInt32, len(offsets)), *places))


def _meet(stage: Stage, mi: Any, scene: Any, ray: Any) -> list[Any]:
    """What a ray meets, and its direction (3)."""
    return [*stage.met(scene.ray_intersect_preliminary(ray, coherent=True), ray), *ray.d]


def _centres(stage: Stage) -> list[Any]:
    """The same of the pixel centres."""
    mi, dr = load_mitsuba(), load_drjit()
    ray = camera_ray(stage, dr.arange(mi.UInt32, stage.width * stage.height), mi.Point2f(0.5))
    met = _meet(stage, mi, stage.mi_scene, past_containers(stage, ray))
    dr.eval(met)  # one kernel instead of one per column
    return met


def _film(stage: Stage, x: Any, y: Any) -> tuple[Any, ...]:
    """What rays through the film at x, y, in units of its size, meet, their directions, and what Seen has of it."""
    mi, dr = load_mitsuba(), load_drjit()
    ray, _ = stage.sensor.sample_ray(0.0, 0.5, mi.Point2f(x, y), mi.Point2f(0.5))
    first = stage.mi_scene.ray_intersect_preliminary(ray, coherent=True)
    si = first.compute_surface_interaction(ray)
    hit = si.is_valid()
    seen = stage.met(first, ray), ray.d, si.p, si.sh_frame.n, stage.roughness(si, hit), hit
    dr.eval(seen)
    return seen


def _surfaces(stage: Stage, count: Any, *places: Any) -> list[Any]:
    return _summed(stage, count, places, lobes=False)


def _surfaces_and_lobes(stage: Stage, count: Any, *places: Any) -> list[Any]:
    return _summed(stage, count, places, lobes=True)


def _summed(stage: Stage, count: Any, places: Sequence[Any], lobes: bool) -> list[Any]:
    """What `queue_surfaces` queues."""
    mi, dr = load_mitsuba(), load_drjit()
    pixel = dr.arange(mi.UInt32, stage.width * stage.height)

    def add(number: Any, *sums: Any) -> tuple[Any, ...]:
        x, y, u, v = (dr.gather(mi.Float, place, number) for place in places)
        ray = camera_ray(stage, pixel, mi.Point2f(x, y), mi.Point2f(u, v))
        direction = _opposite_pairs(number, count) if lobes else None
        seen = _look(stage, mi, stage.mi_scene, past_containers(stage, ray), direction)
        return number + 1, *(total + column for total, column in zip(sums, seen, strict=True))

    start = mi.UInt32(0), *(mi.Float(0) for _ in range(_LOOK + _LOBES * lobes))
    _, *sums = dr.while_loop(start, lambda number, *_: number < count, add)
    dr.eval(sums)
    return list(sums)


def _opposite_pairs(number: Any, count: Any) -> Any:
    """Two numbers for the direction of sample `number` of `count`, see Lobes.diffuse_albedo.

    Pairs of opposite turns, on a golden spiral: where a normal map tilts a lobe, what one direction has too much the
    other has too little. 7 is coprime to powers of two: neighbours in the pixel are no neighbours here.
    """
    mi = load_mitsuba()
    rank = 7 * number % count
    pair = mi.Float(rank // 2)
    return mi.Point2f((pair + 0.5) / (count // 2), _GOLDEN * pair + 0.5 * mi.Float(rank % 2))


def _trace_scalar(stage: Stage, offsets: Floats, look: Callable[[Any, Any, Any], list[Any]]) -> Floats:
    """Values (P, K) of look(mi, scene, ray), summed over the rays at `offsets` (S, 4), one ray at a time."""
    mi = load_mitsuba()

    def values(x: float, y: float, u: float, v: float) -> list[Any]:
        ray, _ = stage.sensor.sample_ray(0.0, 0.5, mi.Point2f(x, y), mi.Point2f(u, v))
        return look(mi, stage.mi_scene, past_containers(stage, ray))

    rows = []
    for row in range(stage.height):  # a row of pixels at a time, as Python's numbers take much memory
        corner = np.stack([np.arange(stage.width), np.full(stage.width, row)], axis=1)
        film = (corner[:, None] + offsets[:, :2]).reshape(-1, 2) / (stage.width, stage.height)
        rays = np.concatenate([film, np.tile(offsets[:, 2:], (stage.width, 1))], axis=1)
        table = np.array([values(*ray) for ray in rays.tolist()], float)
        rows.append(table.reshape(stage.width, len(offsets), -1).sum(1))
    return np.concatenate(rows)


def past_containers(stage: Stage, ray: Any) -> Any:
    """The ray from where it has left whatever cannot be seen: boundaries that let all light pass straight on."""
    for _ in range(2 * stage.containers):  # into and out of each
        si = stage.mi_scene.ray_intersect(ray, load_mitsuba().RayFlags.All, coherent=True)
        if is_scalar():
            if si.is_valid() and min(si.bsdf().eval_null_transmission(si)) == 1:
                ray.o = ray(si.t * _BEHIND)
            continue
        hit, dr = si.is_valid(), load_drjit()
        passes = hit & (dr.min(si.bsdf().eval_null_transmission(si, hit)) == 1)
        ray.o = dr.select(passes, ray(si.t * _BEHIND), ray.o)
    return ray


def _look(stage: Stage, mi: Any, scene: Any, ray: Any, random: Any = None) -> list[Any]:
    """albedo (3), normal (3), roughness, emission (3), hit: 0 where the ray misses.

    With two random numbers, `random`, diffuse_albedo (3) and geometric_normal (3) too; vectorised variants only.
    """
    si = scene.ray_intersect(ray, mi.RayFlags.All, coherent=True)
    bsdf, emitter, hit = si.bsdf(), si.emitter(scene), si.is_valid()
    if is_scalar():
        emission = emitter.eval(si) if emitter else mi.Color3f(0)
        if not hit:
            return [0.0] * 7 + [*emission, 0.0]
        rough = bsdf.eval_attribute_1("roughness", si) if bsdf.has_attribute("roughness") else 1.0
        normal = si.sh_frame.n * (1 if si.wi.z >= 0 else -1)
        return [*bsdf.eval_diffuse_reflectance(si), *normal, rough, *emission, 1.0]
    dr = load_drjit()
    rough = stage.roughness(si, hit)
    normal = dr.select(hit, si.sh_frame.n * dr.select(si.wi.z >= 0, 1, -1), 0)
    albedo = stage.albedo(si, hit)
    seen = [*albedo, *normal, dr.select(hit, rough, 0), *emitter.eval(si), dr.select(hit, mi.Float(1), 0)]
    if random is None:
        return seen
    facing = dr.select(hit, si.n * -dr.sign(dr.dot(si.n, ray.d)), 0)
    return [*seen, *Lobes(si, hit).diffuse_albedo(random), *facing]
