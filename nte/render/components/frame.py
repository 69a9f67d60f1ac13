"""The light components of a frame: one noisy sample of each, and the references that the samples estimate.

`nte.render.components` states the estimators.
"""

from collections.abc import Iterable, Sequence

import numpy as np

from nte.render.components.first_hit import Path, trace_path
from nte.render.components.gradient import shade_again, shade_before
from nte.render.components.lobes import diffuse_albedo
from nte.render.components.reliable_motion import (
    Bounce,
    Shadow,
    mirror_images,
    reflection_vectors,
    shadow_vectors,
)
from nte.render.components.resampling import Direct, ShadowRay, sample_direct, trace_shadow
from nte.render.engine.arrays import to_rows
from nte.render.engine.backend import load_drjit, load_mitsuba
from nte.render.engine.camera_rays import sample_camera_ray
from nte.render.engine.stage import Moment, Scenery, Stage, Timeless
from nte.render.engine.types import Lanes, Sampler
from nte.render.passes.gbuffer import geometry, pattern, surface_of
from nte.render.passes.hits import to_hits
from nte.render.passes.radiance import launches
from nte.render.passes.rays import Surfaces, queue_surfaces, trace_centres
from nte.render.world.scene import Pixels
from nte.render.world.seeds import derive_seed
from nte.render.world.transforms import Floats

_SAMPLES = 1 << 22  # paths per launch; their components take 200 MB before they are summed


def noisy(stage: Stage, time: float, seeds: Sequence[int]) -> tuple[dict[str, Pixels], list[dict[str, Pixels]]]:
    """Render the noise-free channels (C, H, W), and for each seed all noisy channels (C, H, W) at 1 spp.

    time: in frames. Return the noise-free channels, and one dictionary of noisy channels per seed. The noise-free
    channels are those of `guides`, diffuse_albedo, geometric_normal, and direct, which is the mean over the candidates
    of all seeds. The noisy channels are color, visibility, indirect, indirect_radiance, indirect_direction, glossy,
    shadow_motion, reflection_motion, reflection_covariance, and the gradients.

    Kernels are queued as early as possible, so that they run while NumPy works. Reading an array waits for everything
    in the queue. Therefore arrays that are ready are read before the next kernel is queued.
    """
    with stage.at(time) as moment:
        offsets, centres = pattern(moment), trace_centres(moment)
        surfaces = queue_surfaces(moment, offsets, diffuse_albedo=diffuse_albedo)
        paths = [_path(moment, seed) for seed in seeds]
        channels = geometry(moment, centres)
        bounces, seen = [_bounce(moment, path) for path in paths], Surfaces.of(to_rows(surfaces))
        directs, shadow_rays = zip(*(_shadow_ray(moment, seed) for seed in seeds), strict=True)
        channels |= surface_of(moment, seen, len(offsets))
        mirrored = [mirror_images(moment, bounce, time) for bounce in bounces]
        channels["direct"] = np.mean([_image(moment, direct.mean) for direct in directs], axis=0, dtype=np.float32)
        samples = [_light_of(moment, path, ray) for path, ray in zip(paths, shadow_rays, strict=True)]
        shadows = [_shadow(moment, ray) for ray in shadow_rays]
    with stage.at(time - 1) as before:
        replays = [shade_before(before, time, seed) for seed in seeds]
        for sample, shadow in zip(samples, shadows, strict=True):
            sample["visibility"][:, ~channels["direct"].any(0)] = 1
            shadowed = channels["direct"] * sample["visibility"]
            sample["color"] = channels["emission"] + shadowed + sample["glossy"] + sample["indirect"]
            sample["shadow_motion"] = shadow_vectors(before, shadow, time)
        for sample, images in zip(samples, mirrored, strict=True):
            sample["reflection_motion"], sample["reflection_covariance"] = reflection_vectors(before, images, time)
    with stage.at(time) as moment:
        for sample, replay in zip(samples, replays, strict=True):
            sample.update(shade_again(moment, replay))
    return channels, samples


def shadow_samples(moment: Moment, seeds: Sequence[int]) -> list[Pixels]:
    """Render only the shadow_motion (2, H, W) of `noisy`, once for each seed."""
    rays = (_shadow_ray(moment, seed)[1] for seed in seeds)
    return [shadow_vectors(moment, _shadow(moment, ray), moment.time) for ray in rays]


def reflection_samples(stage: Stage, time: float, seeds: Sequence[int]) -> list[tuple[Pixels, Pixels]]:
    """Render only the reflection_motion and reflection_covariance of `noisy`, once per seed. time: in frames."""
    with stage.at(time) as moment:
        mirrored = [mirror_images(moment, _bounce(moment, _path(moment, seed)), time) for seed in seeds]
    with stage.at(time - 1) as before:
        return [reflection_vectors(before, images, time) for images in mirrored]


def references(moment: Moment, spp: int, seeds: tuple[int, int]) -> dict[str, Pixels]:
    """Render reference_a, reference_b, reference_visibility, reference_indirect and reference_glossy (C, H, W).

    spp: paths per pixel in all, half of them from each of the two seeds. The expectation of either half is that of
    `radiance`, a plain path trace.
    """
    first, second = (_sums(moment, spp // 2, seed) for seed in seeds)
    both = first + second
    unshadowed, shadowed = both[3:4], both[4:5]
    visibility = np.divide(shadowed, unshadowed, out=np.ones_like(shadowed), where=unshadowed > 0)
    channels = {
        "reference_a": first[:3] / (spp // 2),
        "reference_b": second[:3] / (spp // 2),
        "reference_visibility": visibility,
        "reference_indirect": both[5:8] / spp,
        "reference_glossy": both[8:11] / spp,
    }
    return {name: np.ascontiguousarray(values, np.float32) for name, values in channels.items()}


def _light_of(moment: Moment, path: Path, ray: ShadowRay) -> dict[str, Pixels]:
    """The light channels of one seed."""
    return {
        "visibility": _image(moment, [ray.visible]),
        "indirect": _image(moment, path.indirect),
        "indirect_radiance": _image(moment, path.indirect_radiance),
        "indirect_direction": _image(moment, path.indirect_direction),
        "glossy": _image(moment, path.glossy),
    }


def _image(timeless: Timeless, columns: Iterable[Lanes]) -> Pixels:
    """Image (C, H, W) of C Dr.Jit arrays (P,)."""
    rows = np.stack([np.array(column, np.float32) for column in columns])
    return rows.reshape(-1, timeless.height, timeless.width)


def _shadow_ray(moment: Moment, seed: int) -> tuple[Direct, ShadowRay]:
    key = load_drjit().opaque(load_mitsuba().UInt32, derive_seed(seed, "direct"))
    direct = moment.frozen(sample_direct)(key)
    return direct, moment.frozen(trace_shadow)(direct, key)


def _path(moment: Moment, seed: int) -> Path:
    """One path per pixel."""
    return moment.frozen(_one_path)(load_drjit().opaque(load_mitsuba().UInt32, derive_seed(seed, "path")))


def _one_path(scenery: Scenery, key: Lanes) -> Path:
    mi, dr = load_mitsuba(), load_drjit()
    pixels = scenery.width * scenery.height
    sampler: Sampler = mi.load_dict({"type": "independent"})
    sampler.seed(key, pixels)
    path = trace_path(scenery, sample_camera_ray(scenery, dr.arange(mi.UInt32, pixels), sampler), sampler)
    dr.eval(path)
    return path


def _shadow(moment: Moment, ray: ShadowRay) -> Shadow:
    return Shadow(
        receiver=to_hits(moment, ray.receiver, ray.view),
        blocker=to_hits(moment, ray.blocker, ray.view),
        light=moment.scenery.lights[np.array(ray.light, np.int64)],
        light_point=np.array(ray.light_point, float).T,
        blocked=np.array(ray.blocked),
    )


def _bounce(moment: Moment, path: Path) -> Bounce:
    return Bounce(
        first=to_hits(moment, path.first, path.direction),
        second=to_hits(moment, path.second, path.direction),
        reflected=np.array(path.is_reflection),
    )


def _sums(moment: Moment, spp: int, seed: int) -> Floats:
    """Sums (11, H, W) over `spp` paths: colour, luminance unshadowed and shadowed, indirect, glossy."""
    mi, dr, scenery = load_mitsuba(), load_drjit(), moment.scenery
    pixels = scenery.width * scenery.height
    total = np.zeros((11, pixels))
    for number, count in enumerate(launches(spp, pixels, _SAMPLES)):
        sampler = scenery.sensor.sampler().clone()
        sampler.set_sample_count(count)
        sampler.set_samples_per_wavefront(count)
        sampler.seed(dr.opaque(mi.UInt32, derive_seed(seed, number)), pixels * count)
        pixel = dr.arange(mi.UInt32, pixels * count) // dr.opaque(mi.UInt32, count)
        path = trace_path(scenery, sample_camera_ray(scenery, pixel, sampler), sampler)
        color = path.emission + path.shadowed + path.glossy + path.indirect
        luminances = mi.luminance(path.unshadowed), mi.luminance(path.shadowed)
        columns = [*color, *luminances, *path.indirect, *path.glossy]
        dr.eval(columns)
        total += np.stack([np.array(dr.block_sum(column, count), float) for column in columns])
    return total.reshape(11, scenery.height, scenery.width)
