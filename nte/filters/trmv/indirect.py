"""Diffuse indirect light: six cones of incident radiance, filtered in space and time (section 4.3)."""

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor
from torch.profiler import record_function

from nte.color import demodulate, remodulate
from nte.filters.atrous import atrous_step
from nte.filters.bilateral import Guide, pair_weight
from nte.filters.trmv.cones import (
    HALF_ANGLE,
    WEIGHTS,
    by_cone,
    irradiance,
    mix_parallel,
    radiance_of,
    sample_to_cones,
    split,
    transfer,
)  # fmt: skip
from nte.filters.trmv.scene import Scene
from nte.filters.trmv.temporal import (
    Effect,
    Settings,
    Track,
    accumulate,
    begin,
    clean_up_deviation,
    fetch,
    finish,
    limit,
    weigh,
)  # fmt: skip
from nte.motion.geometric import Reprojection
from nte.motion.warp import warp

LEVELS = 4
KERNEL = (1.0, 0.5)  # 3×3 taps: 4 levels make 31×31, the paper's «essentially 32×32»


def filter_indirect(values: Tensor, guide: Guide) -> Tensor:
    """À-trous filter (N, C, H, W) over 31×31 pixels of the same surface."""
    for level in range(LEVELS):
        values = atrous_step(values, 2**level, pair_weight, guide, kernel=KERNEL).values
    return values


@dataclass(frozen=True)
class Cones:
    """How cones are made, carried over and shaded."""

    half_angle: float = HALF_ANGLE  # rad
    weights: tuple[float, ...] = WEIGHTS  # of each cone's radiance, sr: EQ_11 is the paper's

    def gather(self, radiance: Tensor, direction: Tensor, normal: Tensor, guide: Guide) -> Tensor:
        """Cones (N, 24, H, W) out of one sample per pixel, filtered in space.

        The à-trous levels are one filter of 31×31, so Ω enters once for a pair of pixels; where its normal test
        lets them mix, cones of the same number are within 7° and share the Ω of equal normals.
        """
        return mix_parallel(filter_indirect(sample_to_cones(radiance, direction, normal), guide), self.half_angle)

    def accumulate(
        self, current: Tensor, track: Track | None, vectors: Reprojection | None, scene: Scene, settings: Settings
    ) -> Effect:
        """`temporal.accumulate`, cone by cone: history's cone k weighs (1 − α) min(1, Σ_j Ω_kj / Ω(0)).

        Cones of the current frame that no previous one overlaps are made of this frame alone, and previous ones
        without overlap are dropped: both have the weight 0.
        """
        if vectors is None or track is None or scene.before is None:
            return begin("indirect", current, vectors, scene, settings)
        with record_function("trmv/indirect/temporal"):
            fetched = fetch(track, vectors, scene.frame.reset)
            normal = F.normalize(warp(scene.before.normal, vectors.motion).image, dim=1)
            moved, covered = transfer(fetched.history, normal, scene.surface.normal, self.half_angle)
            history = radiance_of(moved)
            clamped = limit(history, radiance_of(current), settings)
            weight = weigh(fetched, settings)
            share = split(moved)[1] * covered.unsqueeze(2)
            usable = torch.cat([share * by_cone(clamped, 3), share], 2).flatten(1, 2)
            blended = torch.where(fetched.valid, torch.lerp(usable, current, weight.used), current)
            light, kept = (irradiance(radiance, self.weights) for radiance in (history, clamped))
            deviation = clean_up_deviation(weight, light, kept, fetched.valid)
        return finish("indirect", blended, fetched, weight, deviation, scene, settings)._replace(vectors=vectors)

    def shade(self, cones: Tensor, albedo: Tensor) -> Tensor:
        """Eq. 11 with f_r = albedo / π: reflected light (N, 3, H, W)."""
        return albedo * irradiance(radiance_of(cones), self.weights)


def denoise_indirect(
    scene: Scene, track: Track | None, vectors: str, cones: Cones | None, settings: Settings
) -> Effect:
    """Diffuse indirect light (N, 3, H, W). vectors: dual, traditional or none. cones None: colours are reused."""
    frame = scene.frame
    reprojection = {"dual": scene.dual, "traditional": scene.traditional, "none": None}[vectors]
    if cones is None:
        with record_function("trmv/indirect/filter"):
            current = filter_indirect(demodulate(frame["indirect"], frame["albedo"]), scene.guide)
        effect = accumulate("indirect", current, track, reprojection, scene, settings)
        return effect._replace(image=remodulate(effect.image, frame["albedo"]))
    with record_function("trmv/indirect/filter"):
        light, direction = frame["indirect_radiance"], frame["indirect_direction"]
        current = cones.gather(light, direction, scene.surface.normal, scene.guide)
    effect = cones.accumulate(current, track, reprojection, scene, settings)
    with record_function("trmv/indirect/shade"):
        return effect._replace(image=cones.shade(effect.image, frame["albedo"]))
