"""Diffuse indirect light: six cones of incident radiance, filtered in space and time (section 4.3)."""

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor
from torch.profiler import record_function

from nte.color import demodulate, remodulate
from nte.filters.atrous import atrous_step
from nte.filters.bilateral import Guide, pair_weight
from nte.filters.trmv import cones as hemisphere
from nte.filters.trmv import temporal
from nte.filters.trmv.scene import Scene
from nte.filters.trmv.temporal import Blended, Effect, Fetched, Settings, Track, Weight
from nte.motion.geometric import Reprojection
from nte.motion.warp import warp

LEVELS = 4
KERNEL = (1.0, 0.5)  # 3×3 taps: 4 levels make 31×31, the paper's «essentially 32×32»
REACH = 8.0  # deviation of that filter, px
STRIP = 64  # rows blended and shaded at a time: 24 channels with their temporaries would be most of the frame's memory


def filter_indirect(values: Tensor, guide: Guide) -> Tensor:
    """À-trous filter (N, C, H, W) over 31×31 pixels of the same surface."""
    for level in range(LEVELS):
        values = atrous_step(values, 2**level, pair_weight, guide, kernel=KERNEL).values
    return values


@dataclass(frozen=True)
class Cones:
    """How cones are made, carried over and shaded."""

    half_angle: float = hemisphere.HALF_ANGLE  # rad
    weights: tuple[float, ...] = hemisphere.WEIGHTS  # of each cone's radiance, sr: EQ_11 is the paper's

    def gather(self, radiance: Tensor, direction: Tensor, normal: Tensor, guide: Guide) -> Tensor:
        """Cones (N, 24, H, W) out of one sample per pixel, filtered in space.

        The à-trous levels are one filter of 31×31, so Ω enters once for a pair of pixels; where its normal test
        lets them mix, cones of the same number are within 7° and share the Ω of equal normals.
        """
        return filter_indirect(hemisphere.sample_to_cones(radiance, direction, normal), guide)

    def blend(
        self, current: Tensor, track: Track | None, vectors: Reprojection | None, scene: Scene, settings: Settings
    ) -> Blended:
        """`temporal.accumulate`, cone by cone: history's cone k weighs (1 − α) min(1, Σ_j Ω_kj / Ω(0)).

        Cones of the current frame that no previous one overlaps are made of this frame alone, and previous ones
        without overlap are dropped: both have the weight 0.
        """
        if vectors is None or track is None or scene.before is None:
            return temporal.start(current, settings)
        with record_function("trmv/indirect/temporal"):
            fetched = temporal.fetch(track, vectors, scene.frame.reset)
            weight = temporal.weigh(fetched, settings)
            normal = F.normalize(warp(scene.before.normal, vectors.motion).image, dim=1)
            deviation = torch.empty_like(weight.used)
            for top in range(0, current.shape[2], STRIP):
                rows = slice(top, top + STRIP)
                self._blend_rows(rows, current, fetched, normal, scene, weight, settings, deviation)
            return Blended(fetched.history, temporal.blended_variance(weight, fetched), weight.used, deviation)

    def _blend_rows(
        self, rows: slice, current: Tensor, fetched: Fetched, normal: Tensor, scene: Scene, weight: Weight,
        settings: Settings, deviation: Tensor,
    ) -> None:  # fmt: skip
        """Blend a strip of rows, in the place of the history, and give the clean-up's `deviation`.

        normal: that of the history.
        """

        def cut(image: Tensor) -> Tensor:
            return image[:, :, rows]

        normals = cut(normal), cut(scene.surface.normal)
        moved = hemisphere.transfer(cut(fetched.history), *normals, self.half_angle)
        history = hemisphere.radiance_of(moved)
        reach = temporal.NEIGHBOURHOOD // 2 * temporal.spacing(REACH)
        margin = slice(max(0, rows.start - reach), rows.stop + reach)
        around = hemisphere.radiance_of(current[:, :, margin])
        inner = slice(rows.start - margin.start, rows.start - margin.start + history.shape[2])
        clamped = temporal.limit(history, around, REACH, settings, inner)
        valid, used = cut(fetched.valid), cut(weight.used)
        share = hemisphere.split(moved)[1]
        usable = torch.cat([share * hemisphere.by_cone(clamped, 3), share], 2).flatten(1, 2)
        now = cut(current)
        cut(fetched.history).copy_(torch.where(valid, torch.lerp(usable, now, used), now))
        light, kept = (hemisphere.irradiance(radiance, self.weights) for radiance in (history, clamped))
        doubts = Weight(cut(weight.default), used)
        cut(deviation).copy_(temporal.clean_up_deviation(doubts, light, kept, valid, settings))

    def shade(self, cones: Tensor, albedo: Tensor) -> Tensor:
        """Eq. 11 with f_r = albedo / π: reflected light (N, 3, H, W)."""
        strips = (hemisphere.radiance_of(strip) for strip in torch.split(cones, STRIP, 2))
        return albedo * torch.cat([hemisphere.irradiance(strip, self.weights) for strip in strips], 2)


def denoise_indirect(
    scene: Scene, track: Track | None, vectors: str, cones: Cones | None, settings: Settings
) -> Effect:
    """Diffuse indirect light (N, 3, H, W). vectors: dual, traditional or none. cones None: colours are reused."""
    frame = scene.frame
    reprojection = {"dual": scene.dual, "traditional": scene.traditional, "none": None}[vectors]
    if cones is None:
        with record_function("trmv/indirect/filter"):
            current = filter_indirect(demodulate(frame["indirect"], frame["albedo"]), scene.guide)
        effect = temporal.accumulate("indirect", current, track, reprojection, scene, settings, REACH)
        return effect._replace(image=remodulate(effect.image, frame["albedo"]))
    blended = cones.blend(_gathered(scene, cones), track, reprojection, scene, settings)
    effect = temporal.finish("indirect", blended, reprojection, scene, settings)
    with record_function("trmv/indirect/shade"):
        return effect._replace(image=cones.shade(effect.image, frame["albedo"]))


def _gathered(scene: Scene, cones: Cones) -> Tensor:
    """The current frame's cones (N, 24, H, W), filtered in space."""
    with record_function("trmv/indirect/filter"):
        light, direction = scene.frame["indirect_radiance"], scene.frame["indirect_direction"]
        return cones.gather(light, direction, scene.surface.normal, scene.guide)
