"""Direct light and its one shadow ray: candidates over the pixel and the lights, one of them resampled.

All random numbers are functions of (pixel, seed, candidate), so a chosen candidate is made again from its
number instead of being stored. Estimators: datasets/README.md.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from nte.render.backend import load_drjit, load_mitsuba
from nte.render.gbuffer import pattern
from nte.render.lobes import Lobes
from nte.render.numbers import lattice, uniform
from nte.render.rays import look_at, ray_at
from nte.render.scene import DISTANT
from nte.render.stage import Stage, shape_key
from nte.render.transport import sample_light

CANDIDATES = 128  # light points of a pixel, shared out among the places where its surfaces are looked at
_RAYS = 1 << 24  # at once: 16 M keep a launch under 2 GB


@dataclass(frozen=True)
class Direct:
    """What the candidates of each pixel give, Dr.Jit arrays (P,)."""

    mean: Any  # Color3f
    chosen: Any  # UInt32, the number of the resampled one
    lit: Any  # Bool, whether there is one: false where nothing arrives even unshadowed


@dataclass(frozen=True)
class ShadowRay:
    """The shadow ray of each pixel's chosen candidate, Dr.Jit arrays (P,)."""

    visible: Any  # Bool; true where there is no shadow ray
    blocked: Any  # Bool
    receiver: Any  # PreliminaryIntersection3f of the camera ray
    view: Any  # direction of the camera ray
    blocker: Any  # PreliminaryIntersection3f of the shadow ray
    light: Any  # key of the light's shape (see rays.shape_key)
    light_point: Any  # world; an environment light's is far away


def sample_direct(stage: Stage, seeds: Sequence[int]) -> tuple[list[Any], list[Direct]]:
    """Sums (P,) of what the guides see, `Surfaces`, and for each seed 128 light points, one of which is chosen in
    proportion to the luminance that it gives unshadowed.

    The places of a pixel are the guides' own, so that one kernel makes both, a third faster than two. It is
    queued, not waited for.
    """
    dr, pixels, places = load_drjit(), stage.width * stage.height, len(pattern(stage))
    step = max(1, _RAYS // places)
    parts = [_sample_part(stage, seeds, start, min(step, pixels - start)) for start in range(0, pixels, step)]
    if len(parts) == 1:
        return parts[0]
    sums = [dr.concat(columns) for columns in zip(*(seen for seen, _ in parts), strict=True)]
    by_seed = zip(*(directs for _, directs in parts), strict=True)
    return sums, [
        Direct(*(dr.concat([getattr(part, name) for part in own], -1) for name in ("mean", "chosen", "lit")))
        for own in by_seed
    ]


def _sample_part(stage: Stage, seeds: Sequence[int], start: int, count: int) -> tuple[list[Any], list[Direct]]:
    """The same of `count` pixels from `start` on."""
    mi, dr, offsets = load_mitsuba(), load_drjit(), pattern(stage)
    places = len(offsets)
    lane = dr.arange(mi.UInt32, count * places) + dr.opaque(mi.UInt32, start * places)
    pixel, place = lane // places, lane % places
    si = stage.mi_scene.ray_intersect(ray_at(stage, pixel, offsets, place))
    lobes = Lobes(si, si.is_valid())
    seen, lights = look_at(stage, si), []
    for seed in seeds:
        key = dr.opaque(mi.UInt32, seed)

        def numbers(number: Any, key: Any = key) -> Any:
            return _light_numbers(pixel, place, places, number, key)

        random = uniform(lane, key, "candidate").x
        lights.append(resample_lights(stage, lobes, CANDIDATES // places, numbers, mi.luminance, random))
    dr.eval(seen, [(total, choice.weight, choice.number) for total, choice in lights])

    pixel = dr.arange(mi.UInt32, count)
    directs = []
    for seed, (total, choice) in zip(seeds, lights, strict=True):
        random = uniform(pixel + dr.opaque(mi.UInt32, start), dr.opaque(mi.UInt32, seed), "point").x
        among = Choice(random, mi.Float(0), mi.UInt32(0))
        for number in range(places):
            source = pixel * places + number
            candidate = dr.gather(mi.UInt32, choice.number, source) * places + number
            among.offer(candidate, dr.gather(mi.Float, choice.weight, source))
        mean = mi.Color3f(*(dr.block_sum(channel, places) for channel in total)) / CANDIDATES
        directs.append(Direct(mean, among.number, among.weight > 0))
    sums = [dr.block_sum(column, places) for column in seen]
    dr.eval(sums, [(direct.mean, direct.chosen, direct.lit) for direct in directs])
    return sums, directs


def resample_lights(
    stage: Stage, lobes: Lobes, count: int, numbers: Callable[[Any], Any], importance: Callable[[Any], Any], random: Any
) -> tuple[Any, "Choice"]:
    """Sum (3,) of what `count` light points give unshadowed through the diffuse lobe, and a choice among them.

    numbers: the two random numbers of a light point; importance: of what it gives, in proportion to which
    `random` chooses. A loop in the kernel, as unrolled it takes longer to generate than to run.
    """
    mi, dr = load_mitsuba(), load_drjit()

    def offer(number: Any, total: Any, *state: Any) -> tuple[Any, ...]:
        light = sample_light(stage.mi_scene, lobes.si, lobes.active, numbers(number))
        given = dr.select(lobes.active, lobes.diffuse(light.wo) * light.weight, 0)
        choice = Choice(*state)
        choice.offer(number, importance(given))
        return number + 1, total + given, choice.random, choice.weight, choice.number

    start = mi.UInt32(0), mi.Color3f(0), random, mi.Float(0), mi.UInt32(0)
    _, total, *state = dr.while_loop(start, lambda number, *_: number < count, offer)
    return total, Choice(*state)


def trace_shadow(stage: Stage, direct: Direct, seed: int) -> ShadowRay:
    """The one shadow ray of every pixel, to the light point of the candidate that sample_direct chose."""
    mi, dr = load_mitsuba(), load_drjit()
    pixel = dr.arange(mi.UInt32, stage.width * stage.height)
    offsets, key = pattern(stage), dr.opaque(mi.UInt32, seed)
    places = len(offsets)
    place, number = direct.chosen % places, direct.chosen // places
    ray = ray_at(stage, pixel, offsets, place)
    receiver = stage.mi_scene.ray_intersect_preliminary(ray)
    si = receiver.compute_surface_interaction(ray)
    light = sample_light(stage.mi_scene, si, direct.lit, _light_numbers(pixel, place, places, number, key)).sample
    shadow_ray = si.spawn_ray_to(light.p)
    blocker = stage.mi_scene.ray_intersect_preliminary(shadow_ray, coherent=False, active=direct.lit)
    blocked = direct.lit & blocker.is_valid()
    return ShadowRay(
        visible=~blocked,
        blocked=blocked,
        receiver=receiver,
        view=ray.d,
        blocker=blocker,
        light=shape_key(light.emitter.get_shape()),
        light_point=dr.select(light.emitter.is_environment(), si.p + DISTANT * light.d, light.p),
    )


class Choice:
    """Weighted choice from a stream with a single random number, which is stretched after each decision."""

    def __init__(self, random: Any, weight: Any, number: Any) -> None:
        self.random, self.weight, self.number = random, weight, number

    def offer(self, number: Any, weight: Any) -> None:
        """Take `number` instead with probability weight / (sum of all weights so far)."""
        dr = load_drjit()
        self.weight = self.weight + weight
        share = dr.select(self.weight > 0, weight / self.weight, 0)
        taken = self.random < share
        self.number = dr.select(taken, number, self.number)
        self.random = dr.select(taken, self.random / share, (self.random - share) / (1 - share))


def _light_numbers(pixel: Any, place: Any, places: int, number: Any, key: Any) -> Any:
    """Two random numbers for light point `number` of a place: all 128 of a pixel fill the lights evenly.

    7 is coprime to the number of places: neighbours within the pixel are not neighbours on the light.
    """
    return lattice(pixel, number * places + (7 * place) % places, CANDIDATES, key, "light")
