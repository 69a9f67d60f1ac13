"""Camera rays, one per lane."""

from nte.render.engine.backend import is_scalar, load_drjit, load_mitsuba
from nte.render.engine.stage import Scenery
from nte.render.engine.types import Lanes, Ray, Sampler

_BEHIND = 1 + 1e-4  # a step along the ray itself, because Mitsuba's spawn_ray also steps sideways


def camera_ray(scenery: Scenery, pixel: Lanes, offset: Lanes, lens: Lanes = None) -> Ray:
    """Make rays through `offset` (2,) in [0, 1)² of the pixels, which are numbered row by row.

    lens: a place (2,) in [0, 1)² on the lens; the middle of the lens if None.
    """
    mi = load_mitsuba()
    dr = load_drjit()
    width = dr.opaque(mi.UInt32, scenery.width)  # not a literal: one kernel for every size
    row = pixel // width
    corner = mi.Point2f(mi.Float(pixel - row * width), mi.Float(row))
    size = mi.Vector2f(dr.opaque(mi.Float, scenery.width), dr.opaque(mi.Float, scenery.height))
    ray, _ = scenery.sensor.sample_ray(0.0, 0.5, (corner + offset) / size, mi.Point2f(0.5) if lens is None else lens)
    return ray


def sample_camera_ray(scenery: Scenery, pixel: Lanes, sampler: Sampler) -> Ray:
    """Make rays through a random place in each of the pixels, and through a random place on the lens if there is one.

    pixel: pixel numbers, counted row by row.
    """
    offset = sampler.next_2d()
    return camera_ray(scenery, pixel, offset, sampler.next_2d() if scenery.camera.aperture else None)


def past_containers(scenery: Scenery, ray: Ray) -> Ray:
    """Move a ray past every container: an invisible boundary of a medium, which lets all light pass straight on."""
    for _ in range(2 * scenery.containers):  # into and out of each
        si = scenery.mi_scene.ray_intersect(ray, load_mitsuba().RayFlags.All, coherent=True)
        if is_scalar():
            if si.is_valid() and min(si.bsdf().eval_null_transmission(si)) == 1:
                ray.o = ray(si.t * _BEHIND)
            continue
        hit, dr = si.is_valid(), load_drjit()
        passes = hit & (dr.min(si.bsdf().eval_null_transmission(si, hit)) == 1)
        ray.o = dr.select(passes, ray(si.t * _BEHIND), ray.o)
    return ray
