"""Camera rays and their hits: the same code for vectorised and scalar Mitsuba variants."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from typing import Literal, Protocol

import numpy as np
import numpy.typing as npt

from nte.render.engine.arrays import to_jit, to_rows
from nte.render.engine.backend import is_scalar, load_drjit, load_mitsuba
from nte.render.engine.camera_rays import camera_ray, past_containers
from nte.render.engine.stage import Moment, Scenery
from nte.render.engine.types import Interaction, Lanes, MitsubaScene, Module, Ray
from nte.render.passes.hits import Hits, hits_of, to_hits
from nte.render.world.transforms import Floats

# What albedo shows of a surface that reflects or refracts without scattering: its own colour, black or white. Renderers
# do not agree on it. Only the `principled` material says how far it is a mirror; others show what they give.
Mirrors = Literal["colour", "black", "white"]

_GOLDEN = (5**0.5 - 1) / 2
_MIRROR = ("metallic", "spec_trans")  # attributes: the shares of light that a metal and that glass take
_LOOK, _LOBES = 11, 6  # columns of Surfaces: those always there, and those of the diffuse lobe


class DiffuseAlbedo(Protocol):
    """A function that estimates the albedo (3,) of the diffuse lobe at surface interactions, for the active lanes.

    random: two numbers that choose a direction (see nte.render.components.lobes).
    """

    def __call__(self, si: Interaction, active: Lanes, *, random: Lanes) -> Lanes: ...

    def __hash__(self) -> int: ...


@dataclass(frozen=True)
class Surfaces:
    """Sums (P, components) over the samples in each pixel; a sample that misses adds 0."""

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
    """The hits of single camera rays: one row per ray, undefined where `hit` is false."""

    point: Floats  # (R, 3) world
    normal: Floats  # (R, 3) shading normal, world
    roughness: Floats  # (R,) perceptual
    hit: npt.NDArray[np.bool_]  # (R,)
    hits: Hits


def trace_film(moment: Moment, pixel: Floats) -> Seen:
    """Find what is seen at pixel positions (R, 2), inside or outside the image. Vectorised variants only."""
    film = [to_jit(load_mitsuba().Float, column) for column in (pixel / (moment.width, moment.height)).T]
    met, direction, *columns = moment.frozen(_film)(*film)
    hits = to_hits(moment, met, direction)
    point, normal, roughness, found = (np.array(column).T for column in columns)
    return Seen(point.astype(float), normal.astype(float), roughness.astype(float), found, hits)


def trace_centres(moment: Moment) -> Hits:
    """Find what the rays through the pixel centres hit."""
    middle = np.full((1, 4), 0.5)
    if is_scalar():
        rows = _trace_scalar(moment.scenery, middle, partial(_meet, moment.scenery))
    else:
        rows = to_rows(moment.frozen(_centres)())
    return hits_of(moment, rows[:, :-3], rows[:, -3:])


def trace_surfaces(moment: Moment, offsets: Floats, mirrors: Mirrors = "colour") -> Surfaces:
    """Sum what is seen at `offsets`, in [0, 1)⁴: (S, 4) of every pixel, or (P, S, 4) with places of its own for each.

    The first two numbers of an offset are a place in the pixel, the others a place on the lens if there is one. A half
    each is the middle.
    """
    if is_scalar():
        return Surfaces.of(_trace_scalar(moment.scenery, offsets, partial(_look, moment.scenery, mirrors)))
    return Surfaces.of(to_rows(queue_surfaces(moment, offsets, mirrors)))


def queue_surfaces(
    moment: Moment, offsets: Floats, mirrors: Mirrors = "colour", diffuse_albedo: DiffuseAlbedo | None = None
) -> list[Lanes]:
    """Queue the kernel that sums the columns of Surfaces, Dr.Jit arrays (P,), and do not wait for it.

    offsets: see `trace_surfaces`. diffuse_albedo: a function that estimates it; if given, the columns of diffuse_albedo
    and geometric_normal are summed too.
    """
    mi, dr = load_mitsuba(), load_drjit()
    samples, stride = offsets.shape[-2], offsets.shape[-2] if offsets.ndim == 3 else 0
    places = [to_jit(mi.Float, column) for column in offsets.reshape(-1, 4).T]
    numbers = (dr.opaque(mi.UInt32, number) for number in (samples, stride))
    return list(moment.frozen(_summing(mirrors, diffuse_albedo))(*numbers, *places))


def _meet(scenery: Scenery, mi: Module, scene: MitsubaScene, ray: Ray) -> list[Lanes]:
    """The hit of a ray, as Scenery.met returns it, and the ray's direction (3)."""
    return [*scenery.met(scene.ray_intersect_preliminary(ray, coherent=True), ray), *ray.d]


def _centres(scenery: Scenery) -> list[Lanes]:
    """The hits of the rays through the pixel centres, and their directions (3)."""
    mi, dr = load_mitsuba(), load_drjit()
    ray = camera_ray(scenery, dr.arange(mi.UInt32, scenery.width * scenery.height), mi.Point2f(0.5))
    met = _meet(scenery, mi, scenery.mi_scene, past_containers(scenery, ray))
    dr.eval(met)  # one kernel instead of one per column
    return met


def _film(scenery: Scenery, x: Lanes, y: Lanes) -> tuple[Lanes, ...]:
    """The hits of rays through the film, their directions, and the columns of Seen.

    x, y: places on the film, in units of its size.
    """
    mi, dr = load_mitsuba(), load_drjit()
    ray, _ = scenery.sensor.sample_ray(0.0, 0.5, mi.Point2f(x, y), mi.Point2f(0.5))
    first = scenery.mi_scene.ray_intersect_preliminary(ray, coherent=True)
    si = first.compute_surface_interaction(ray)
    hit = si.is_valid()
    seen = scenery.met(first, ray), ray.d, si.p, si.sh_frame.n, scenery.roughness(si, hit), hit
    dr.eval(seen)
    return seen


@cache  # the same function for every frame, so a stage records it once
def _summing(mirrors: Mirrors, diffuse_albedo: DiffuseAlbedo | None) -> Callable[..., list[Lanes]]:
    """The kernel that `queue_surfaces` queues; pixels share their places, or have `stride` places of their own each."""

    def summed(scenery: Scenery, count: Lanes, stride: Lanes, *places: Lanes) -> list[Lanes]:
        mi, dr = load_mitsuba(), load_drjit()
        pixel = dr.arange(mi.UInt32, scenery.width * scenery.height)

        def add(number: Lanes, *sums: Lanes) -> tuple[Lanes, ...]:
            x, y, u, v = (dr.gather(mi.Float, place, number + stride * pixel) for place in places)
            ray = past_containers(scenery, camera_ray(scenery, pixel, mi.Point2f(x, y), mi.Point2f(u, v)))
            closer = partial(diffuse_albedo, random=_opposite_pairs(number, count)) if diffuse_albedo else None
            seen = _look(scenery, mirrors, mi, scenery.mi_scene, ray, closer)
            return number + 1, *(total + column for total, column in zip(sums, seen, strict=True))

        start = mi.UInt32(0), *(mi.Float(0) for _ in range(_LOOK + (_LOBES if diffuse_albedo else 0)))
        _, *sums = dr.while_loop(start, lambda number, *_: number < count, add)
        dr.eval(sums)
        return list(sums)

    return summed


def _opposite_pairs(number: Lanes, count: Lanes) -> Lanes:
    """Two numbers for the direction by which sample `number` of `count` estimates the diffuse albedo.

    The samples form pairs of opposite azimuths on a golden spiral: where a normal map tilts a lobe, the excess of one
    direction cancels the deficit of the other. 7 is coprime to powers of two, so neighbours in the pixel are not
    neighbours here.
    """
    mi = load_mitsuba()
    rank = 7 * number % count
    pair = mi.Float(rank // 2)
    return mi.Point2f((pair + 0.5) / (count // 2), _GOLDEN * pair + 0.5 * mi.Float(rank % 2))


def _trace_scalar(
    scenery: Scenery, offsets: Floats, look: Callable[[Module, MitsubaScene, Ray], list[Lanes]]
) -> Floats:
    """Values (P, K) of look(mi, scene, ray), summed over the rays at `offsets`, (S, 4) or (P, S, 4), one at a time."""
    mi = load_mitsuba()

    def values(x: float, y: float, u: float, v: float) -> list[Lanes]:
        ray, _ = scenery.sensor.sample_ray(0.0, 0.5, mi.Point2f(x, y), mi.Point2f(u, v))
        return look(mi, scenery.mi_scene, past_containers(scenery, ray))

    rows = []
    for row in range(scenery.height):  # a row of pixels at a time, because Python's numbers take much memory
        corner = np.stack([np.arange(scenery.width), np.full(scenery.width, row)], axis=1)
        own = offsets[row * scenery.width : (row + 1) * scenery.width] if offsets.ndim == 3 else offsets[None]
        own = np.broadcast_to(own, (scenery.width, *own.shape[1:]))
        film = (corner[:, None] + own[..., :2]) / (scenery.width, scenery.height)
        rays = np.concatenate([film, own[..., 2:]], axis=-1).reshape(-1, 4)
        table = np.array([values(*ray) for ray in rays.tolist()], float)
        rows.append(table.reshape(scenery.width, own.shape[1], -1).sum(1))
    return np.concatenate(rows)


def _look(
    scenery: Scenery,
    mirrors: Mirrors,
    mi: Module,
    scene: MitsubaScene,
    ray: Ray,
    diffuse_albedo: Callable[[Interaction, Lanes], Lanes] | None = None,
) -> list[Lanes]:
    """albedo (3), normal (3), roughness, emission (3), hit: 0 where the ray misses.

    With an estimator of diffuse_albedo, also diffuse_albedo (3) and geometric_normal (3); vectorised variants only.
    """
    si = scene.ray_intersect(ray, mi.RayFlags.All, coherent=True)
    bsdf, emitter, hit = si.bsdf(), si.emitter(scene), si.is_valid()
    if is_scalar():
        emission = emitter.eval(si) if emitter else mi.Color3f(0)
        if not hit:
            return [0.0] * 7 + [*emission, 0.0]
        rough = bsdf.eval_attribute_1("roughness", si) if bsdf.has_attribute("roughness") else 1.0
        normal = si.sh_frame.n * (1 if si.wi.z >= 0 else -1)
        albedo = bsdf.eval_diffuse_reflectance(si)
        if mirrors != "colour":
            known = [name for name in _MIRROR if bsdf.has_attribute(name)]
            share = min(1.0, sum(bsdf.eval_attribute_1(name, si) for name in known))
            albedo = albedo * (1 - share) + (share if mirrors == "white" else 0.0)
        return [*albedo, *normal, rough, *emission, 1.0]
    dr = load_drjit()
    rough = scenery.roughness(si, hit)
    normal = dr.select(hit, si.sh_frame.n * dr.select(si.wi.z >= 0, 1, -1), 0)
    albedo = scenery.albedo(si, hit)
    if mirrors != "colour":
        share = dr.minimum(sum(scenery.attribute(name, si, hit, 0) for name in _MIRROR), 1)
        albedo = albedo * (1 - share) + (share if mirrors == "white" else 0)
    seen = [*albedo, *normal, dr.select(hit, rough, 0), *emitter.eval(si), dr.select(hit, mi.Float(1), 0)]
    if diffuse_albedo is None:
        return seen
    facing = dr.select(hit, si.n * -dr.sign(dr.dot(si.n, ray.d)), 0)
    return [*seen, *diffuse_albedo(si, hit), *facing]
