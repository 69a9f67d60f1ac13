"""Diffuse indirect light: six cones of incident radiance, filtered in space and time (section 4.3)."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import torch
import torch.nn.functional as F
from torch import Tensor

from nte.color import demodulate, remodulate
from nte.filters.bilateral import Edges, atrous_bilateral
from nte.filters.blocks import texture_of
from nte.filters.scope import scope
from nte.filters.threads import side_by_side, threads_for
from nte.filters.trmv import accumulation
from nte.filters.trmv import cones as hemisphere
from nte.filters.trmv.accumulation import Blended, Effect, History, Weight
from nte.filters.trmv.fetch import Fetcher, fetch_from_anything, fetch_from_surface
from nte.filters.trmv.inputs import FrameInputs
from nte.filters.trmv.options import TrmvOptions
from nte.filters.trmv.samples import of_usable
from nte.frames.usable import mask_of

LEVELS = 4  # à-trous levels of 3×3 taps: 31×31 px, the paper's «essentially 32×32»
REACH = 8.0  # px, deviation of that filter
STRIP = 96  # rows fetched, blended and shaded at a time, since temporaries of 24 channels need much memory


def filter_indirect(values: Tensor, edges: Edges, in_place: bool = False) -> Tensor:
    """Filter values (N, C, H, W) by à-trous levels over 31×31 pixels of the same surface."""
    return atrous_bilateral(values, edges, LEVELS, in_place)


@dataclass(frozen=True)
class Cones:
    """The way in which cones are made, carried over and shaded."""

    half_angle: float = hemisphere.HALF_ANGLE  # rad
    weights: tuple[float, ...] = hemisphere.WEIGHTS  # of each cone's radiance, sr; EQ_11 has the paper's

    def gather(self, radiance: Tensor, direction: Tensor, normal: Tensor, edges: Edges) -> Tensor:
        """Make cones (N, 24, H, W) out of one sample per pixel, filtered in space.

        radiance, direction and normal (N, 3, H, W): as in `sample_to_cones`. Pixels that the filter's normal test lets
        mix have cones of the same number within 7° of each other.
        """
        cones = radiance.new_empty(len(radiance), 4 * hemisphere.CONES, *radiance.shape[2:])

        def sort(first: int) -> None:
            strip = (image[:, :, first : first + STRIP] for image in (radiance, direction, normal))
            cones[:, :, first : first + STRIP] = hemisphere.sample_to_cones(*strip)

        _by_strips(sort, cones)
        return filter_indirect(cones, edges, in_place=True)

    def blend(
        self,
        current: Tensor,
        history: History,
        fetcher: Fetcher,
        trust: Tensor | None,
        inputs: FrameInputs,
        options: TrmvOptions,
    ) -> Blended:
        """Blend the current cones with history, each cone with the weight of its samples; overwrites `current`.

        A cone into which no sample of the history falls consists of this frame alone, and samples that turned below the
        horizon are dropped.
        """
        assert inputs.before is not None
        with scope("trmv/indirect/temporal"):
            before = inputs.before.normal
            variance, may = accumulation.fetch_convergence(history, fetcher, inputs.frame.reset)
            weight = accumulation.weigh(variance, may, options, trust)
            deviation, level = torch.empty_like(weight.used), accumulation.level_of(inputs.frame["indirect_radiance"])
            beside = _margins(current, accumulation.NEIGHBOURHOOD // 2 * accumulation.spacing(REACH))

            def blend(first: int) -> None:
                """Blend one strip of rows in place."""

                def cut(image: Tensor) -> Tensor:
                    return image[:, :, first : first + STRIP]

                now, valid = cut(current), cut(may)
                past, normal = (fetcher(image, first, now.shape[2]) for image in (history.values, before))
                hemisphere.transfer(past, F.normalize(normal, dim=1), cut(inputs.gbuffer.normal), self.half_angle)
                above, below = beside[first]
                inner = slice(above.shape[2], above.shape[2] + now.shape[2])
                light, kept = self._limit(past, torch.cat([above, now, below], 2), inner, options)
                now.copy_(torch.where(valid, torch.lerp(past, now, cut(weight.used)), now))
                doubts = Weight(cut(weight.default), cut(weight.used))
                cut(deviation).copy_(accumulation.clean_up_deviation(doubts, light, kept, valid, options, level))

            _by_strips(blend, current)
            return Blended(current, accumulation.blended_variance(weight, variance), weight.used, deviation)

    def _limit(self, history: Tensor, around: Tensor, inner: slice, options: TrmvOptions) -> tuple[Tensor, Tensor]:
        """Clamp the light that the history's cones make, in place; returns the light before and after, (N, 3, h, W).

        history: cones of a strip. around: cones of the current frame there, in its rows `inner`, and of the rows that
        the clamp needs above and below. All cones of a pixel are scaled alike, or raised alike, and not clamped one by
        one. Cones of one number face elsewhere at another normal, and bright samples are so rare in a single cone that
        most frames have none nearby, so light from few directions would be lost on surfaces that are not flat.
        """
        light = hemisphere.irradiance(history, self.weights)
        if options.clamp == float("inf"):
            return light, light
        now, known = hemisphere.irradiance(around, self.weights), hemisphere.known(around)
        kept = accumulation.limit(light, now, known, REACH, options, inner).clamp(min=0)  # rounding may end below 0
        scale = torch.where(kept < light, kept / light, 1.0)
        more = (kept - light).clamp_(min=0).mul_(math.pi / sum(self.weights))
        radiance, weight = hemisphere.split(history)
        radiance.mul_(scale[:, None]).addcmul_(more[:, None], weight)
        return light, kept

    def shade(self, cones: Tensor, reflectance: Tensor) -> Tensor:
        """Compute the reflected light (N, 3, H, W) by Eq. 11, with f_r = reflectance of the diffuse lobe / π."""
        light = torch.empty_like(reflectance)

        def shade(first: int) -> None:
            rows = slice(first, first + STRIP)
            light[:, :, rows] = hemisphere.irradiance(cones[:, :, rows], self.weights)

        _by_strips(shade, cones)
        return light.mul_(reflectance)


def _margins(image: Tensor, reach: int) -> dict[int, tuple[Tensor, Tensor]]:
    """Copies of the rows (N, C, ≤ reach, W) above and below each strip of an image, by the strip's first row."""
    firsts = range(0, image.shape[2], STRIP)
    return {
        first: (image[:, :, max(0, first - reach) : first].clone(), image[:, :, first + STRIP :][:, :, :reach].clone())
        for first in firsts
    }


def _by_strips(work: Callable[[int], None], image: Tensor) -> None:
    """Run `work` on the first row of each strip of an image (N, C, H, W)."""
    side_by_side([partial(work, first) for first in range(0, image.shape[2], STRIP)], threads_for(image))


def denoise_indirect(
    inputs: FrameInputs, history: History | None, vectors: str, cones: Cones | None, options: TrmvOptions,
    trust: Tensor | None = None,
) -> Effect:  # fmt: skip
    """Denoise diffuse indirect light (N, 3, H, W).

    vectors: dual, traditional or none. cones: None reuses colours instead. trust (N, 1, H, W): of the history, in
    [0, 1]. History comes from the same surface only, except for colours along traditional vectors, the paper's
    comparison.
    """
    frame, reflectance = inputs.frame, texture_of(inputs.frame, "indirect")
    reprojection = {"dual": inputs.dual, "traditional": inputs.traditional, "none": None}[vectors]
    fetcher = None
    if reprojection is not None and history is not None:
        anything = cones is None and vectors == "traditional"
        fetcher = fetch_from_anything(reprojection) if anything else fetch_from_surface(reprojection, inputs)
    if cones is None:
        with scope("trmv/indirect/filter"):
            light, usable = demodulate(frame["indirect"], reflectance), frame.get(mask_of("indirect"))
            current, known = of_usable(partial(filter_indirect, edges=inputs.edges), light, usable)
        effect = accumulation.accumulate(
            "indirect", current, history, reprojection, inputs, options, REACH, trust, fetcher, known
        )
        return effect._replace(image=remodulate(effect.image, reflectance))
    with scope("trmv/indirect/filter"):
        light, direction = frame["indirect_radiance"], frame["indirect_direction"]
        usable = frame.get(mask_of("indirect_radiance"))
        direction = direction if usable is None else direction * usable  # a zero direction marks no sample
        current = cones.gather(light, direction, inputs.gbuffer.normal, inputs.edges)
    blended = accumulation.start(current, options)
    if fetcher is not None and history is not None:
        blended = cones.blend(current, history, fetcher, trust, inputs, options)
    effect = accumulation.finish("indirect", blended, reprojection, inputs, options)
    with scope("trmv/indirect/shade"):
        return effect._replace(image=cones.shade(effect.image, reflectance))
