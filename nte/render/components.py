"""The light components of a frame: one noisy sample of each, and the references that they are estimates of.

The estimators and their expectations are written in datasets/README.md, «Estimators».
"""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from nte.render.arrays import to_rows
from nte.render.backend import load_drjit, load_mitsuba
from nte.render.gbuffer import geometry, pattern, surface_of
from nte.render.gradient import shade_again, shade_before
from nte.render.integrator import launches
from nte.render.rays import Surfaces, queue_surfaces, to_hits, trace_centres
from nte.render.resampling import Direct, ShadowRay, sample_direct, trace_shadow
from nte.render.scene import Pixels
from nte.render.seeds import derive_seed
from nte.render.stage import Stage
from nte.render.transforms import Floats
from nte.render.transport import Path, sample_camera_ray, trace_path
from nte.render.vectors import Bounce, Shadow, mirror_images, reflection_vectors, shadow_vectors

_SAMPLES = 1 << 22  # paths per launch: their components are stored before they are summed, 200 MB
_Row = npt.NDArray[Any]


def noisy(stage: Stage, time: float, seeds: Sequence[int]) -> tuple[dict[str, Pixels], list[dict[str, Pixels]]]:
    """The channels without noise (C, H, W), and for each seed every noisy one, at 1 spp.

    time: in frames; leaves `stage` set to it. Without noise: those of `guides`, diffuse_albedo, geometric_normal, and
    direct, which is the mean over the candidates of all seeds. The noisy
    channels: color, visibility, indirect, indirect_radiance, indirect_direction, glossy, shadow_motion,
    reflection_motion, reflection_covariance, and the gradients.

    Kernels are queued as early as they can be: what NumPy does in between, it does while they run. Whoever reads one
    array waits for all that is queued, so what is at hand is read first, then the next kernel queued.
    """
    stage.set_time(time)
    centres = trace_centres(stage)
    surfaces = queue_surfaces(stage, pattern(stage), lobes=True)
    paths = [_path(stage, seed) for seed in seeds]
    channels = geometry(stage, time, centres)
    bounces, seen = [_bounce(stage, path) for path in paths], Surfaces.of(to_rows(surfaces))
    directs, shadow_rays = zip(*(_shadow_ray(stage, seed) for seed in seeds), strict=True)
    channels |= surface_of(stage, seen)
    mirrored = [mirror_images(stage, bounce, time) for bounce in bounces]
    channels["direct"] = np.mean([_image(stage, direct.mean) for direct in directs], axis=0, dtype=np.float32)

    samples = [_light_of(stage, path, ray) for path, ray in zip(paths, shadow_rays, strict=True)]
    shadows = [_shadow(stage, ray) for ray in shadow_rays]
    stage.set_time(time - 1)
    replays = [shade_before(stage, time, seed) for seed in seeds]
    for sample, shadow in zip(samples, shadows, strict=True):
        sample["visibility"][:, ~channels["direct"].any(0)] = 1
        shadowed = channels["direct"] * sample["visibility"]
        sample["color"] = channels["emission"] + shadowed + sample["glossy"] + sample["indirect"]
        sample["shadow_motion"] = shadow_vectors(stage, shadow, time)
    for sample, images in zip(samples, mirrored, strict=True):
        sample["reflection_motion"], sample["reflection_covariance"] = reflection_vectors(stage, images, time)
    stage.set_time(time)
    for sample, replay in zip(samples, replays, strict=True):
        sample.update(shade_again(stage, time, replay))
    return channels, samples


def shadow_samples(stage: Stage, time: float, seeds: Sequence[int]) -> list[Pixels]:
    """The shadow_motion of `noisy` alone, for each seed."""
    rays = (_shadow_ray(stage, seed)[1] for seed in seeds)
    return [shadow_vectors(stage, _shadow(stage, ray), time) for ray in rays]


def reflection_samples(stage: Stage, time: float, seeds: Sequence[int]) -> list[tuple[Pixels, Pixels]]:
    """The reflection_motion and reflection_covariance of `noisy` alone, for each seed."""
    mirrored = [mirror_images(stage, _bounce(stage, _path(stage, seed)), time) for seed in seeds]
    stage.set_time(time - 1)
    vectors = [reflection_vectors(stage, images, time) for images in mirrored]
    stage.set_time(time)
    return vectors


def references(stage: Stage, spp: int, seeds: tuple[int, int]) -> dict[str, Pixels]:
    """reference_a, reference_b, reference_visibility, reference_indirect and reference_glossy (C, H, W).

    spp paths per pixel in all, half of them from each seed, at the time that `stage` is set to. The halves'
    expectation is that of `radiance`, a plain path trace.
    """
    first, second = (_sums(stage, spp // 2, seed) for seed in seeds)
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


def _light_of(stage: Stage, path: Path, ray: ShadowRay) -> dict[str, Pixels]:
    """The light channels of one seed."""
    return {
        "visibility": _image(stage, [ray.visible]),
        "indirect": _image(stage, path.indirect),
        "indirect_radiance": _image(stage, path.indirect_radiance),
        "indirect_direction": _image(stage, path.indirect_direction),
        "glossy": _image(stage, path.glossy),
    }


def _image(stage: Stage, columns: Iterable[Any]) -> Pixels:
    """(C, H, W) of Dr.Jit arrays (P,)."""
    rows = np.stack([np.array(column, np.float32) for column in columns])
    return rows.reshape(-1, stage.height, stage.width)


def _shadow_ray(stage: Stage, seed: int) -> tuple[Direct, ShadowRay]:
    key = load_drjit().opaque(load_mitsuba().UInt32, derive_seed(seed, "direct"))
    direct = stage.frozen(sample_direct)(key)
    return direct, stage.frozen(trace_shadow)(direct, key)


def _path(stage: Stage, seed: int) -> Path:
    """One path per pixel."""
    path: Path = stage.frozen(_one_path)(load_drjit().opaque(load_mitsuba().UInt32, derive_seed(seed, "path")))
    return path


def _one_path(stage: Stage, key: Any) -> Path:
    mi, dr = load_mitsuba(), load_drjit()
    pixels = stage.width * stage.height
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(key, pixels)
    path = trace_path(stage, sample_camera_ray(stage, dr.arange(mi.UInt32, pixels), sampler), sampler)
    dr.eval(path)
    return path


def _shadow(stage: Stage, ray: ShadowRay) -> Shadow:
    return Shadow(
        receiver=to_hits(stage, ray.receiver, ray.view),
        blocker=to_hits(stage, ray.blocker, ray.view),
        light=stage.lights[np.array(ray.light, np.int64)],
        light_point=np.array(ray.light_point, float).T,
        blocked=np.array(ray.blocked),
    )


def _bounce(stage: Stage, path: Path) -> Bounce:
    return Bounce(
        first=to_hits(stage, path.first, path.direction),
        second=to_hits(stage, path.second, path.direction),
        reflected=np.array(path.is_reflection),
    )


def _sums(stage: Stage, spp: int, seed: int) -> Floats:
    """Sums (11, H, W) over `spp` paths: colour, luminance unshadowed and shadowed, indirect, glossy."""
    mi, dr = load_mitsuba(), load_drjit()
    pixels = stage.width * stage.height
    total = np.zeros((11, pixels))
    for number, count in enumerate(launches(spp, pixels, _SAMPLES)):
        sampler = stage.sensor.sampler().clone()
        sampler.set_sample_count(count)
        sampler.set_samples_per_wavefront(count)
        sampler.seed(dr.opaque(mi.UInt32, derive_seed(seed, number)), pixels * count)
        pixel = dr.arange(mi.UInt32, pixels * count) // dr.opaque(mi.UInt32, count)
        path = trace_path(stage, sample_camera_ray(stage, pixel, sampler), sampler)
        color = path.emission + path.shadowed + path.glossy + path.indirect
        luminances = mi.luminance(path.unshadowed), mi.luminance(path.shadowed)
        columns = [*color, *luminances, *path.indirect, *path.glossy]
        dr.eval(columns)
        total += np.stack([np.array(dr.block_sum(column, count), float) for column in columns])
    return total.reshape(11, stage.height, stage.width)
