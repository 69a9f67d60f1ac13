"""One light path per lane, separated at its first hit; Dr.Jit arrays.

The estimators and their expectations are written in datasets/README.md, «Estimators». Only the first hit is
ours; what arrives there along the sampled direction is Mitsuba's own path integrator.
"""

from dataclasses import dataclass
from typing import Any

from nte.render.components.lobes import Lobes
from nte.render.engine.backend import load_drjit, load_mitsuba
from nte.render.engine.mesh_stage import Stage


@dataclass(frozen=True)
class Light:
    """A light point seen from surface interactions, not tested for blockers. Dr.Jit arrays, a lane each."""

    sample: Any  # DirectionSample3f
    weight: Any  # (3,) radiance / density on the solid angle; 0 = no light there
    wo: Any  # direction to it, local


@dataclass(frozen=True)
class Path:
    """One path per lane: radiance (3,) of each component before any mean over the pixel, and where it went."""

    emission: Any  # L_e at the first hit
    unshadowed: Any  # F: the diffuse lobe's answer to one light point
    shadowed: Any  # F · V
    glossy: Any
    indirect: Any
    indirect_radiance: Any  # 0 where the direction was not chosen by the diffuse lobe
    indirect_direction: Any
    is_reflection: Any  # whether it was chosen by another lobe, on the side that o is on
    first: Any  # what Stage.met says of the first hit
    second: Any  # of the hit along the direction
    direction: Any  # the direction, world


def sample_light(scene: Any, si: Any, active: Any, sample: Any) -> Light:
    """The light point that two random numbers choose, out of all lights."""
    chosen, weight = scene.sample_emitter_direction(si, sample, False, active)
    return Light(chosen, weight, si.to_local(chosen.d))


def sample_camera_ray(stage: Stage, pixel: Any, sampler: Any) -> Any:
    """Rays through a random place in each of the pixels numbered row by row, and of the lens if there is one."""
    offset = sampler.next_2d()
    return camera_ray(stage, pixel, offset, sampler.next_2d() if stage.scene.camera.aperture else None)


def camera_ray(stage: Stage, pixel: Any, offset: Any, lens: Any = None) -> Any:
    """Rays through `offset` (2,) in [0, 1)² of the pixels numbered row by row; lens: the same on it, or its middle."""
    mi = load_mitsuba()
    dr = load_drjit()
    width = dr.opaque(mi.UInt32, stage.width)  # not a literal: one kernel for every size
    row = pixel // width
    corner = mi.Point2f(mi.Float(pixel - row * width), mi.Float(row))
    size = mi.Vector2f(dr.opaque(mi.Float, stage.width), dr.opaque(mi.Float, stage.height))
    ray, _ = stage.sensor.sample_ray(0.0, 0.5, (corner + offset) / size, mi.Point2f(0.5) if lens is None else lens)
    return ray


def trace_path(stage: Stage, ray: Any, sampler: Any) -> Path:
    """Follow camera rays into the scene: `follow` from what they meet."""
    return follow(stage, ray, stage.mi_scene.ray_intersect_preliminary(ray, coherent=True), sampler)


def follow(stage: Stage, ray: Any, first: Any, sampler: Any) -> Path:
    """One light point and one direction at the first hit, a PreliminaryIntersection3f; then Mitsuba's integrator."""
    mi, dr, scene = load_mitsuba(), load_drjit(), stage.mi_scene
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
    arriving, _, _ = stage.beyond.sample(scene, sampler, mi.RayDifferential3f(onward), None, on)
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
        first=stage.met(first, ray),
        second=stage.met(second, onward),
        direction=onward.d,
    )


def _balance(mine: Any, other: Any) -> Any:
    """The balance heuristic: mine / (mine + other), 0 where both are 0."""
    dr = load_drjit()
    total = mine + other
    return dr.select(total > 0, mine / total, 0)
