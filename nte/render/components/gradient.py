"""Temporal gradients: the light that a few surface points of the previous frame send to the eye, then and now.

Schied et al. 2018, «Gradient Estimation for Real-Time Adaptive Temporal Filtering», section 3. Both values are shaded
with the same random numbers, so they differ by what has changed in the scene and not by noise. Where nothing has
changed they are equal to the last bit. Each light component has a pair of its own, because a change in one component
(a moving shadow) may leave the others as they are.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from nte.color import ALBEDO_FLOOR
from nte.render.components.first_hit import follow, sample_light
from nte.render.components.lobes import Lobes
from nte.render.components.resampling import resample_lights
from nte.render.engine.arrays import to_jit
from nte.render.engine.backend import load_drjit, load_mitsuba
from nte.render.engine.camera_rays import camera_ray
from nte.render.engine.places import Indices
from nte.render.engine.random_numbers import lattice, uniform
from nte.render.engine.stage import Moment, Scenery, Timeless
from nte.render.engine.types import Hit, Lanes, Ray, Sampler
from nte.render.passes.hits import Hits, points_at, to_hits
from nte.render.passes.projection import eye, pixel_positions
from nte.render.world.scene import Pixels
from nte.render.world.seeds import derive_seed
from nte.render.world.transforms import Floats

STRATUM = 3  # pixels: one sample in each square of 3×3
_CANDIDATES = 16  # light points at a sample's surface point; one of them gets a shadow ray
_IN_FRONT = 1e-3  # something hides a point if it is nearer by more than this share of the distance
GRADIENTS = ("gradient", "gradient_visibility", "gradient_indirect", "gradient_glossy")  # in the order of `_shade`


@dataclass(frozen=True)
class Replay:
    """One surface point for each stratum of the current frame, shaded in the previous frame; one row each."""

    key: Lanes  # the seed, UInt32 (1,)
    hit: Hit  # PreliminaryIntersection3f (S,)
    point: Floats  # (S, 3) where it is in the current frame, world
    pixel: Indices  # (S,) of the current frame, row by row
    found: npt.NDArray[np.bool_]  # (S,) whether the stratum has a surface point
    values: tuple[Lanes, ...]  # what `_shade` returned in the previous frame, for each of GRADIENTS


def shade_before(before: Moment, time: float, seed: int) -> Replay:
    """Choose surface points of a frame that a later frame, at `time` in frames, will shade again, and shade them.

    before: the moment of the earlier frame, by convention at time − 1. Hand the result to `shade_again`.
    """
    mi, dr = load_mitsuba(), load_drjit()
    key = dr.opaque(mi.UInt32, derive_seed(seed, "gradient"))
    hit, met, direction, priority = before.frozen(_candidates)(key)
    hits = to_hits(before, met, direction)
    now = points_at(before, hits, time)
    source, pixel, found = _choose(before, hits, now, time, np.array(priority))
    chosen = dr.gather(mi.PreliminaryIntersection3f, hit, to_jit(mi.UInt32, source))
    dr.eval(chosen)
    then = points_at(before, hits.of(source), before.time)
    values = before.frozen(_shade)(chosen, *_eye_ray(before, then), to_jit(mi.Bool, found), key)
    return Replay(key, chosen, now[source], pixel, found, values)


def shade_again(moment: Moment, replay: Replay) -> dict[str, Pixels]:
    """Render GRADIENTS, each (2, H, W): L, shaded now, and P, shaded in the previous frame; NaN without a sample.

    moment: at the time for which `replay` was made. The same pixels have a sample in all gradients, at most one per
    stratum. A stratum has none where no surface point of the previous frame moves into it, or where something now
    hides the chosen point.
    """
    origin, direction, distance = _eye_ray(moment, replay.point)
    seen = moment.frozen(_seen)(origin, direction, distance, to_jit(load_mitsuba().Bool, replay.found))
    hit = moment.scenery.carried(replay.hit)
    values = moment.frozen(_shade)(hit, origin, direction, distance, seen, replay.key)
    rows = np.array(seen)
    images = {}
    for name, now, before in zip(GRADIENTS, values, replay.values, strict=True):
        image = np.full((2, moment.height * moment.width), np.nan, np.float32)
        image[:, replay.pixel[rows]] = np.array(now)[rows], np.array(before)[rows]
        images[name] = image.reshape(2, moment.height, moment.width)
    return images


def _candidates(scenery: Scenery, key: Lanes) -> tuple[Hit, list[Lanes], Lanes, Lanes]:
    """The points that a random place in each pixel sees, for `_choose`.

    Returns the hits as Mitsuba and as Scenery.met describe them, the rays' directions, and a random number.
    """
    mi, dr = load_mitsuba(), load_drjit()
    lane = dr.arange(mi.UInt32, scenery.width * scenery.height)
    ray = camera_ray(scenery, lane, uniform(lane, key, "gradient jitter"))
    hit = scenery.mi_scene.ray_intersect_preliminary(ray, coherent=True)
    candidates = hit, scenery.met(hit, ray), ray.d, uniform(lane, key, "gradient choice").x
    dr.eval(candidates)
    return candidates


def _choose(
    timeless: Timeless, hits: Hits, now: Floats, time: float, priority: npt.NDArray[np.generic]
) -> tuple[Indices, Indices, npt.NDArray[np.bool_]]:
    """For each stratum (S,) of the frame at `time`: the row of `hits`, the pixel it lies in, and whether there is one.

    Of several points in a pixel the nearest wins; of several pixels in a stratum the one of lowest priority.
    """
    position = pixel_positions(timeless, now, time)
    inside = (hits.instance > 0) & (position >= 0).all(1) & (position < (timeless.width, timeless.height)).all(1)
    row = np.flatnonzero(inside)
    x, y = position[row].astype(np.int64).T
    distance = np.linalg.norm(now[row] - eye(timeless, time), axis=1)
    nearest = _first_of_each(y * timeless.width + x, distance)
    row, x, y = row[nearest], x[nearest], y[nearest]
    across, down = -(-timeless.width // STRATUM), -(-timeless.height // STRATUM)
    stratum = y // STRATUM * across + x // STRATUM
    best = _first_of_each(stratum, priority[row])
    source, pixel = np.zeros((2, across * down), np.int64)
    found = np.zeros(across * down, bool)
    source[stratum[best]] = row[best]
    pixel[stratum[best]] = (y * timeless.width + x)[best]
    found[stratum[best]] = True
    return source, pixel, found


def _first_of_each(group: Indices, order: npt.NDArray[np.generic]) -> Indices:
    """Index of the row of lowest `order` in each group, the first of equal ones. Five times as fast as sorting."""
    least = np.full(group.max(initial=-1) + 1, np.inf)
    np.minimum.at(least, group, order)
    rows = np.flatnonzero(order == least[group])[::-1]
    first = np.full(len(least), -1)
    first[group[rows]] = rows  # where a group is assigned several times, the last value stays
    return np.asarray(first[first >= 0])


def _seen(scenery: Scenery, origin: Lanes, direction: Lanes, distance: Lanes, found: Lanes) -> Lanes:
    """Whether nothing stands between the eye and the points that were found."""
    mi, dr = load_mitsuba(), load_drjit()
    ray: Ray = mi.Ray3f(origin, direction)
    ray.maxt = distance * (1 - _IN_FRONT)
    seen = found & ~scenery.mi_scene.ray_test(ray, found)
    dr.eval(seen)
    return seen


def _shade(
    scenery: Scenery, hit: Hit, origin: Lanes, direction: Lanes, distance: Lanes, active: Lanes, key: Lanes
) -> tuple[Lanes, ...]:
    """The light that points send to the eye, without their own emission: a number (S,) for each of GRADIENTS.

    The numbers are what filters see: the luminance of all light over albedo; the visibility of the chosen light
    point, 1 where no light could arrive; the luminance of indirect light over albedo; the luminance of glossy light.
    The random numbers depend on (row, key) only, not on the time. `hit` names the points on their surfaces; the rays
    reach them at `distance`. Rows that are not active are 0. The kernel is queued, not waited for.
    """
    mi, dr, scene = load_mitsuba(), load_drjit(), scenery.mi_scene
    ray: Ray = mi.RayDifferential3f(origin, direction)
    hit = mi.PreliminaryIntersection3f(hit)
    hit.valid = active
    hit.t = dr.select(hit.valid, distance, dr.inf)
    si = hit.compute_surface_interaction(ray)
    lobes = Lobes(si, si.is_valid())
    albedo = dr.maximum(dr.minimum(scenery.albedo(si, lobes.active), 1), ALBEDO_FLOOR)

    def demodulated(radiance: Lanes) -> Lanes:
        return mi.luminance(radiance / albedo)

    rows = dr.width(distance)
    lane = dr.arange(mi.UInt32, rows)

    def numbers(number: Lanes) -> Lanes:
        return lattice(lane, number, _CANDIDATES, key, "gradient light")

    random = uniform(lane, key, "candidate").x
    total, choice = resample_lights(scenery, lobes, _CANDIDATES, numbers, demodulated, random)
    lit = choice.weight > 0
    light = sample_light(scene, si, lit, numbers(choice.number)).sample
    blocked = lit & scene.ray_test(si.spawn_ray_to(light.p), lit)
    sampler: Sampler = mi.load_dict({"type": "independent"})
    sampler.seed(key, rows)
    path = follow(scenery, ray, hit, sampler)
    color = dr.select(lit & ~blocked, total / _CANDIDATES, 0) + path.glossy + path.indirect
    sent = demodulated(color), mi.Float(~blocked), demodulated(path.indirect), mi.luminance(path.glossy)
    values = tuple(dr.select(lobes.active, value, 0) for value in sent)
    dr.eval(values)
    return values


def _eye_ray(moment: Moment, point: Floats) -> tuple[Lanes, Lanes, Lanes]:
    """Origin (3,), direction (3,) and length of the rays from the camera to points (S, 3); Dr.Jit arrays.

    Like all camera rays they start at the near plane.
    """
    mi = load_mitsuba()
    camera, start = moment.camera, eye(moment, moment.time)
    along = point - start
    distance = np.linalg.norm(along, axis=1)
    direction = along / np.maximum(distance, 1e-9)[:, None]
    cosine = direction @ camera.track(moment.time)[:3, 2]
    near = np.minimum(camera.near / np.maximum(cosine, 1e-9), distance)
    origin, distance = start + near[:, None] * direction, distance - near
    columns = [to_jit(mi.Float, column) for column in (*origin.T, *direction.T, distance)]
    return mi.Point3f(columns[:3]), mi.Vector3f(columns[3:6]), columns[6]
