"""One light path per lane, separated into components at its first hit; Dr.Jit arrays.

`nte.render.components` states the estimators. Only the first hit is computed here; Mitsuba's own path integrator gives
the light that arrives there along the sampled direction.
"""

from dataclasses import dataclass

from nte.render.components.lobes import Lobes
from nte.render.engine.backend import load_drjit, load_mitsuba
from nte.render.engine.stage import Scenery
from nte.render.engine.types import Hit, Interaction, Lanes, MitsubaScene, Ray, Sampler, Struct


@dataclass(frozen=True)
class Light:
    """A light point seen from surface interactions, before any visibility test. Dr.Jit arrays, one lane each."""

    sample: Struct  # DirectionSample3f
    weight: Lanes  # (3,) radiance / density on the solid angle; 0 = no light there
    wo: Lanes  # direction to it, local


@dataclass(frozen=True)
class Path:
    """One path per lane: the radiance (3,) of each component, before any mean over the pixel, and the path's hits."""

    emission: Lanes  # L_e at the first hit
    unshadowed: Lanes  # F: what the diffuse lobe reflects of one light point
    shadowed: Lanes  # F · V
    glossy: Lanes
    indirect: Lanes
    indirect_radiance: Lanes  # 0 where another lobe than the diffuse one chose the direction
    indirect_direction: Lanes
    is_reflection: Lanes  # whether another lobe chose the direction, on the viewer's side of the surface
    first: list[Lanes]  # the first hit, as Scenery.met returns it
    second: list[Lanes]  # the hit along the direction, likewise
    direction: Lanes  # the direction, world


def sample_light(scene: MitsubaScene, si: Interaction, active: Lanes, sample: Lanes) -> Light:
    """Choose a light point among all lights from two random numbers, `sample` (2,) in [0, 1)²."""
    chosen, weight = scene.sample_emitter_direction(si, sample, False, active)
    return Light(chosen, weight, si.to_local(chosen.d))


def trace_path(scenery: Scenery, ray: Ray, sampler: Sampler) -> Path:
    """Trace camera rays to their first hits and `follow` the paths from there."""
    return follow(scenery, ray, scenery.mi_scene.ray_intersect_preliminary(ray, coherent=True), sampler)


def follow(scenery: Scenery, ray: Ray, first: Hit, sampler: Sampler) -> Path:
    """Trace a path from its first hit: one light point and one direction there, then Mitsuba's integrator."""
    mi, dr, scene = load_mitsuba(), load_drjit(), scenery.mi_scene
    si = first.compute_surface_interaction(ray)
    hit = si.is_valid()
    lobes = Lobes(si, hit)

    light = sample_light(scene, si, hit, sampler.next_2d())
    diffuse, others = lobes.split(light.wo)
    lit = hit & (dr.max(light.weight * (diffuse + others)) > 0)
    visible = lit & ~scene.ray_test(si.spawn_ray_to(light.sample.p), lit)
    unshadowed = dr.select(lit, diffuse * light.weight, 0)
    seen = _balance(light.sample.pdf, dr.select(light.sample.delta, 0, lobes.pdf(light.wo)))
    highlight = dr.select(visible, others * light.weight * seen, 0)

    chosen, weight = lobes.sample(sampler)
    on = hit & (dr.max(weight) > 0)
    delta = mi.has_flag(chosen.sampled_type, mi.BSDFFlags.Delta)
    diffuse, others = lobes.split(chosen.wo)
    diffuse = dr.select(on & ~delta, diffuse / chosen.pdf, 0)
    others = dr.select(on, dr.select(delta, weight, others / chosen.pdf), 0)
    onward = si.spawn_ray(si.to_world(chosen.wo))
    second = scene.ray_intersect_preliminary(onward, coherent=False, active=on)
    there = second.compute_surface_interaction(onward, active=on)
    emitter = there.emitter(scene, on)
    emitted = dr.select(on, emitter.eval(there, on), 0)
    density = scene.pdf_emitter_direction(si, mi.DirectionSample3f(scene, there, si), on & ~delta)
    arriving, _, _ = scenery.beyond.sample(scene, sampler, mi.RayDifferential3f(onward), None, on)
    reflected = dr.select(on, dr.maximum(arriving - emitted, 0), 0)

    is_diffuse = on & mi.has_flag(chosen.sampled_type, mi.BSDFFlags.DiffuseReflection)
    return Path(
        emission=si.emitter(scene).eval(si),
        unshadowed=unshadowed,
        shadowed=dr.select(visible, unshadowed, 0),
        glossy=highlight + others * (emitted * _balance(chosen.pdf, dr.select(delta, 0, density)) + reflected),
        indirect=diffuse * reflected,
        indirect_radiance=dr.select(is_diffuse, reflected, 0),
        indirect_direction=dr.select(is_diffuse, onward.d, 0),
        is_reflection=on & ~is_diffuse & (chosen.wo.z * si.wi.z > 0),
        first=scenery.met(first, ray),
        second=scenery.met(second, onward),
        direction=onward.d,
    )


def _balance(mine: Lanes, other: Lanes) -> Lanes:
    """The balance heuristic mine / (mine + other); 0 where both are 0."""
    dr = load_drjit()
    total = mine + other
    return dr.select(total > 0, mine / total, 0)
