"""Direct light and its one shadow ray: candidates over the pixel and the lights, one of them resampled.

All random numbers are functions of (pixel, seed, candidate). A chosen candidate is therefore computed again from its
number instead of being stored. `nte.render.components` states the estimators.
"""

from collections.abc import Callable
from dataclasses import dataclass

from nte.render.components.first_hit import sample_light
from nte.render.components.lobes import Lobes
from nte.render.engine.backend import load_drjit, load_mitsuba
from nte.render.engine.camera_rays import camera_ray
from nte.render.engine.keys import emitter_key
from nte.render.engine.random_numbers import lattice, uniform
from nte.render.engine.stage import Scenery
from nte.render.engine.types import Hit, Interaction, Lanes, Ray

POINTS = 16  # points in each pixel, with a camera ray for each
LIGHTS = 8  # light points for each point: 128 candidates
CANDIDATES = POINTS * LIGHTS


@dataclass(frozen=True)
class Direct:
    """The direct light of each pixel's candidates, Dr.Jit arrays (P,)."""

    mean: Lanes  # Color3f, over all candidates
    chosen: Lanes  # UInt32, the number of the resampled candidate
    lit: Lanes  # Bool, whether a candidate was chosen; false where no light arrives even without shadows


@dataclass(frozen=True)
class ShadowRay:
    """The shadow ray of each pixel's chosen candidate, Dr.Jit arrays (P,)."""

    visible: Lanes  # Bool; true where there is no shadow ray
    blocked: Lanes  # Bool
    receiver: list[Lanes]  # the hit of the camera ray, as Scenery.met returns it
    view: Lanes  # direction of the camera ray
    blocker: list[Lanes]  # the hit of the shadow ray, likewise
    light: Lanes  # key of the light (keys.emitter_key)
    light_point: Lanes  # world; far away for a distant light


def sample_direct(scenery: Scenery, key: Lanes) -> Direct:
    """Sample 128 candidates in every pixel, and choose one in proportion to the luminance that it gives unshadowed.

    key: the seed, UInt32 (1,). The kernel is queued, not waited for.
    """
    mi, dr = load_mitsuba(), load_drjit()
    pixels = scenery.width * scenery.height
    lane = dr.arange(mi.UInt32, pixels * POINTS)
    pixel, point = lane // POINTS, lane % POINTS
    _, _, si = _receiver(scenery, pixel, point, key)
    lobes = Lobes(si, si.is_valid())

    def numbers(number: Lanes) -> Lanes:
        return _light_numbers(pixel, point, number, key)

    total, choice = resample_lights(scenery, lobes, LIGHTS, numbers, mi.luminance, uniform(lane, key, "candidate").x)
    dr.eval(total, choice.weight, choice.number)
    mean = mi.Color3f(*(dr.block_sum(channel, POINTS) for channel in total)) / CANDIDATES

    pixel = dr.arange(mi.UInt32, pixels)
    among = Choice(uniform(pixel, key, "point").x, mi.Float(0), mi.UInt32(0))
    for number in range(POINTS):
        source = pixel * POINTS + number
        candidate = dr.gather(mi.UInt32, choice.number, source) * POINTS + number
        among.offer(candidate, dr.gather(mi.Float, choice.weight, source))
    direct = Direct(mean, among.number, among.weight > 0)
    dr.eval(direct)
    return direct


def resample_lights(
    scenery: Scenery,
    lobes: Lobes,
    count: int,
    numbers: Callable[[Lanes], Lanes],
    importance: Callable[[Lanes], Lanes],
    random: Lanes,
) -> tuple[Lanes, "Choice"]:
    """Sum the unshadowed light of `count` light points through the diffuse lobe, (3,), and choose one of the points.

    numbers: maps the number of a light point to its two random numbers. importance: maps the light of a point to a
    weight; `random` chooses a point in proportion to it. The loop runs in the kernel, because an unrolled loop takes
    longer to compile than to run.
    """
    mi, dr = load_mitsuba(), load_drjit()

    def offer(number: Lanes, total: Lanes, *state: Lanes) -> tuple[Lanes, ...]:
        light = sample_light(scenery.mi_scene, lobes.si, lobes.active, numbers(number))
        given = dr.select(lobes.active, lobes.diffuse(light.wo) * light.weight, 0)
        choice = Choice(*state)
        choice.offer(number, importance(given))
        return number + 1, total + given, choice.random, choice.weight, choice.number

    start = mi.UInt32(0), mi.Color3f(0), random, mi.Float(0), mi.UInt32(0)
    _, total, *state = dr.while_loop(start, lambda number, *_: number < count, offer)
    return total, Choice(*state)


def trace_shadow(scenery: Scenery, direct: Direct, key: Lanes) -> ShadowRay:
    """Trace the one shadow ray of every pixel, to the light point of the candidate that sample_direct chose."""
    mi, dr = load_mitsuba(), load_drjit()
    pixel = dr.arange(mi.UInt32, scenery.width * scenery.height)
    point, number = direct.chosen % POINTS, direct.chosen // POINTS
    ray, receiver, si = _receiver(scenery, pixel, point, key)
    light = sample_light(scenery.mi_scene, si, direct.lit, _light_numbers(pixel, point, number, key)).sample
    shadow_ray = si.spawn_ray_to(light.p)
    blocker = scenery.mi_scene.ray_intersect_preliminary(shadow_ray, coherent=False, active=direct.lit)
    blocked = direct.lit & blocker.is_valid()
    distant = mi.has_flag(light.emitter.flags(), mi.EmitterFlags.Infinite)
    shadow = ShadowRay(
        visible=~blocked,
        blocked=blocked,
        receiver=scenery.met(receiver, ray),
        view=ray.d,
        blocker=scenery.met(blocker, shadow_ray),
        light=emitter_key(light.emitter),
        light_point=dr.select(distant, si.p + scenery.distant * light.d, light.p),
    )
    dr.eval(shadow)  # one kernel instead of one per array
    return shadow


class Choice:
    """Weighted choice from a stream with a single random number, which is stretched after each decision."""

    def __init__(self, random: Lanes, weight: Lanes, number: Lanes) -> None:
        self.random, self.weight, self.number = random, weight, number

    def offer(self, number: Lanes, weight: Lanes) -> None:
        """Replace the choice by `number` with probability weight / (sum of all weights so far)."""
        dr = load_drjit()
        self.weight = self.weight + weight
        share = dr.select(self.weight > 0, weight / self.weight, 0)
        taken = self.random < share
        self.number = dr.select(taken, number, self.number)
        self.random = dr.select(taken, self.random / share, (self.random - share) / (1 - share))


def _receiver(scenery: Scenery, pixel: Lanes, point: Lanes, key: Lanes) -> tuple[Ray, Hit, Interaction]:
    """Camera ray through one of the 16 points of each pixel, with its preliminary and its surface interaction."""
    has_lens = scenery.camera.aperture > 0
    lens = lattice(pixel, 7 * point % POINTS, POINTS, key, "lens") if has_lens else None
    ray = camera_ray(scenery, pixel, lattice(pixel, point, POINTS, key, "jitter"), lens)
    hit = scenery.mi_scene.ray_intersect_preliminary(ray, coherent=True)
    return ray, hit, hit.compute_surface_interaction(ray)


def _light_numbers(pixel: Lanes, point: Lanes, number: Lanes, key: Lanes) -> Lanes:
    """Two random numbers for light point `number` of 8; all 128 of a pixel cover the lights evenly.

    7 is coprime to 16, so neighbours within the pixel are not neighbours on the light.
    """
    return lattice(pixel, number * POINTS + (7 * point) % POINTS, CANDIDATES, key, "light")
