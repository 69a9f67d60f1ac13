"""The light components of a frame: one noisy sample of each, and the references that they are estimates of.

The estimators and their expectations are written in datasets/README.md, «Estimators».
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from nte.render.backend import load_drjit, load_mitsuba
from nte.render.gradient import shade_again, shade_before
from nte.render.integrator import launches
from nte.render.rays import to_hits
from nte.render.resampling import Direct, ShadowRay, sample_direct, trace_shadow
from nte.render.scene import Pixels
from nte.render.seeds import derive_seed
from nte.render.stage import Stage
from nte.render.transforms import Floats
from nte.render.transport import Path, sample_camera_ray, trace_path
from nte.render.vectors import Bounce, Shadow, reflection_vectors, shadow_vectors

_SAMPLES = 1 << 22  # paths per launch: their components are stored before they are summed, 200 MB
_Row = npt.NDArray[Any]


def noisy(stage: Stage, time: float, seeds: Sequence[int], emission: Pixels) -> tuple[Pixels, list[dict[str, Pixels]]]:
    """`direct` (3, H, W) and, for each seed, every noisy channel (C, H, W) at 1 spp, at a time in frames.

    direct is the mean over the candidates of all seeds. The channels: color, visibility, indirect,
    indirect_radiance, indirect_direction, glossy, shadow_motion, reflection_motion, reflection_covariance, gradient.
    emission (3, H, W) is that of the guides. `stage` must be set to `time`, and is left so.
    """
    samples = [_sample(stage, seed) for seed in seeds]
    direct = np.asarray(np.mean([direct for direct, *_ in samples], axis=0, dtype=np.float32))
    for _, channels, shadow, _ in samples:
        channels["visibility"][:, ~direct.any(0)] = 1
        channels["color"] = emission + direct * channels["visibility"] + channels["glossy"] + channels["indirect"]
        channels["shadow_motion"] = shadow_vectors(stage, shadow, time)
    stage.set_time(time - 1)
    replays = [shade_before(stage, time, seed) for seed in seeds]
    for _, channels, _, bounce in samples:
        channels["reflection_motion"], channels["reflection_covariance"] = reflection_vectors(stage, bounce, time)
    stage.set_time(time)
    for (_, channels, _, _), replay in zip(samples, replays, strict=True):
        channels["gradient"] = shade_again(stage, time, replay)
    return direct, [channels for _, channels, _, _ in samples]


def shadow_samples(stage: Stage, time: float, seeds: Sequence[int]) -> list[Pixels]:
    """The shadow_motion of `noisy` alone, for each seed."""
    rays = (_shadow_ray(stage, seed)[1] for seed in seeds)
    return [shadow_vectors(stage, _shadow(stage, ray), time) for ray in rays]


def reflection_samples(stage: Stage, time: float, seeds: Sequence[int]) -> list[tuple[Pixels, Pixels]]:
    """The reflection_motion and reflection_covariance of `noisy` alone, for each seed."""
    bounces = [_bounce(stage, _path(stage, seed)) for seed in seeds]
    stage.set_time(time - 1)
    vectors = [reflection_vectors(stage, bounce, time) for bounce in bounces]
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


def _sample(stage: Stage, seed: int) -> tuple[Pixels, dict[str, Pixels], Shadow, Bounce]:
    """direct, the light channels, and what the shadow ray and the path met, for one seed."""
    dr = load_drjit()
    candidates, shadow = _shadow_ray(stage, seed)
    path = _path(stage, seed)
    light = [path.indirect, path.indirect_radiance, path.indirect_direction, path.glossy]
    dr.eval(shadow, light, path.first, path.second, path.direction, path.is_reflection)

    def image(*columns: Any) -> Pixels:
        rows = np.stack([np.array(column, np.float32) for column in columns])
        return rows.reshape(-1, stage.height, stage.width)

    channels = {
        "visibility": image(shadow.visible),
        "indirect": image(*path.indirect),
        "indirect_radiance": image(*path.indirect_radiance),
        "indirect_direction": image(*path.indirect_direction),
        "glossy": image(*path.glossy),
    }
    return candidates.direct, channels, _shadow(stage, shadow), _bounce(stage, path)


def _shadow_ray(stage: Stage, seed: int) -> tuple[Direct, ShadowRay]:
    seed = derive_seed(seed, "direct")
    candidates = sample_direct(stage, seed)
    return candidates, trace_shadow(stage, candidates, seed)


def _path(stage: Stage, seed: int) -> Path:
    """One path per pixel."""
    mi, dr = load_mitsuba(), load_drjit()
    pixels = stage.width * stage.height
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(dr.opaque(mi.UInt32, derive_seed(seed, "path")), pixels)
    return trace_path(stage, sample_camera_ray(stage, dr.arange(mi.UInt32, pixels), sampler), sampler)


def _shadow(stage: Stage, ray: ShadowRay) -> Shadow:
    load_drjit().eval(ray)  # one kernel instead of one per array
    return Shadow(
        receiver=to_hits(stage, ray.receiver, ray.view),
        blocker=to_hits(stage, ray.blocker, ray.view),
        light=stage.instances[np.array(ray.light, np.int64)],
        light_point=np.array(ray.light_point, float).T,
        blocked=np.array(ray.blocked),
    )


def _bounce(stage: Stage, path: Path) -> Bounce:
    load_drjit().eval(path.first, path.second, path.direction, path.is_reflection)
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
