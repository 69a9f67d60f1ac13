"""Shading without noise: input for motion blur filters in which only visibility is random.

Oberberger et al. 2022, «Spatiotemporal Variance-Guided Filtering for Motion Blur», section 3, trace no secondary rays,
and leave out shadows and reflections. A sample costs about as much as a path of depth 2, and a reference needs a third
of the samples.
"""

from functools import cache
from itertools import product

from nte.render.engine.backend import load_drjit, load_mitsuba
from nte.render.engine.types import Integrator, Lanes, MitsubaScene, Ray, Sampler, Struct

POINTS = tuple((x, y) for x in (0.25, 0.75) for y in (0.25, 0.75))  # on each light, the same for every pixel


@cache
def unshadowed_integrator() -> Integrator:
    """Return a Mitsuba integrator of emission + albedo · E / π, where E is the irradiance without any blockers.

    Every surface is treated as a diffuse surface of its `albedo`, metal and glass too. Vectorised variants only.
    """
    mi, dr = load_mitsuba(), load_drjit()

    class Unshadowed(mi.SamplingIntegrator):  # type: ignore[misc, name-defined]
        def sample(
            self, scene: MitsubaScene, sampler: Sampler, ray: Ray, medium: Struct = None, active: Lanes = True
        ) -> tuple[Lanes, Lanes, list[Lanes]]:
            si = scene.ray_intersect(ray, mi.RayFlags.All, True, active)
            hit = si.is_valid()
            normal = si.sh_frame.n * dr.select(si.wi.z >= 0, 1, -1)
            irradiance, lights = mi.Color3f(0), len(scene.emitters())
            for number, (x, y) in product(range(lights), POINTS):
                sample = mi.Point2f((number + x) / lights, y)  # chooses this light, and this point on it
                light, radiance = scene.sample_emitter_direction(si, sample, False, hit)
                irradiance += radiance * dr.maximum(dr.dot(normal, light.d), 0) / (lights * len(POINTS))
            reflected = si.bsdf().eval_diffuse_reflectance(si, hit) * irradiance / dr.pi
            return dr.select(active, si.emitter(scene).eval(si), 0) + dr.select(hit, reflected, 0), active, []

    made: Integrator = Unshadowed(mi.Properties())
    return made
