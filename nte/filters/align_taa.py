"""Temporal antialiasing of images without Monte Carlo noise, along correspondences found in the images alone.

Hanika, Tessari and Dachsbacher 2021, «Fast Temporal Reprojection without Motion Vectors», sections 3.2 and 4.
"""

from dataclasses import dataclass
from typing import Literal, NamedTuple

import torch
from torch import Tensor

from nte.denoiser import Filter, Result, State, sanitised
from nte.filters.align import Aligned, SearchOptions, align
from nte.filters.blocks import clamp_history, fetch_finite, keep_where_bad, remembered, restarts, usable_moments
from nte.filters.estimated import Seen, look
from nte.frames.channels import GUIDES
from nte.frames.frame import Frame
from nte.motion.catmull_rom import warp_catmull_rom
from nte.motion.correspondence import rejection_mask
from nte.motion.warp import warp
from nte.options import NotNegative

LOOSE, TIGHT = 2.0, 0.5  # tolerance in σ where albedo and normal agree (a shadow moved), and where they do not
_DIFFERENT = 0.1  # mean difference of the components of albedo or normal from which the tolerance is TIGHT


class _State(NamedTuple):
    output: Tensor  # (N, 3, H, W)
    seen: Seen  # the frame, as the search compares it
    guides: Seen | None  # albedo and normal, if the tolerance uses them


@dataclass(frozen=True)
class AlignTaaOptions(SearchOptions, name="align_taa"):
    """Options of TAA without motion vectors: those of the search, and its own.

    guides: search in albedo and normal, which have no noise, instead of the image. tolerance: of the clamp, `fixed`
    (1 σ), or `adaptive`: 2 σ, falling to 0.5 σ where history's albedo or normal differs from the current one. alpha:
    weight of the current frame where the mask m is 1.
    """

    kappa: NotNegative = 40.0
    eta: NotNegative = 0.0
    guides: bool = False
    tolerance: Literal["fixed", "adaptive"] = "fixed"


class AlignTaa(Filter[AlignTaaOptions]):
    """TAA without motion vectors: history is fetched with Catmull–Rom and clamped to μ ± σ of 3×3 pixels.

    The mask m = κ ε − η of the patch error ε is used inverted: history is blended in where m is large, at edges and
    where the image changes, and flat areas keep the current frame. Extras: `motion` and `mask`.
    """

    options_type = AlignTaaOptions
    extras = ("motion", "mask")

    def __init__(self, options: AlignTaaOptions | None = None, *, device: str = "cpu") -> None:
        super().__init__(options, device=device)
        how = self.options
        self.choose = how.chooser()
        looks = GUIDES if how.guides or how.tolerance == "adaptive" else ()
        self.needs = ("color", *looks, *(["motion"] if how.motion == "geometric" else []))

    @sanitised
    def step(self, frame: Frame, state: State, extras: tuple[str, ...] = ()) -> tuple[Result, State]:
        """Blend the frame with its history; the state holds the output and the image that was searched."""
        how = self.options
        current = frame["color"]
        seen, before = look(frame, GUIDES if how.guides else ("color",), state and state.seen)
        guides = look(frame, GUIDES, state and state.guides)[0] if how.tolerance == "adaptive" else None
        output, valid = current, torch.zeros_like(current[:, :1], dtype=torch.bool)
        mask = torch.zeros_like(current[:, :1])
        aligned = Aligned(current.new_zeros(frame.batch, 2, *frame.size), mask > 0, mask)
        if before is not None:
            starts = restarts(frame)
            aligned = align(seen.image, before, frame, how.motion, self.choose)
            aligned = aligned._replace(motion=torch.where(starts, 0.0, aligned.motion), valid=aligned.valid & ~starts)
            mask = torch.where(starts, 0.0, rejection_mask(aligned.error, how.kappa, how.eta))
            output, valid = self._blend(current, mask, aligned, guides, state, frame)
        found = {"motion": aligned.motion, "mask": mask}
        result = Result(output, {name: found[name] for name in extras})
        return result, _State(remembered(output, valid, frame, "color"), seen, guides)

    def _blend(
        self, current: Tensor, mask: Tensor, aligned: Aligned, guides: Seen | None, state: _State, frame: Frame
    ) -> tuple[Tensor, Tensor]:
        """The blended image, and where it has a history."""
        past, found = fetch_finite(warp_catmull_rom, state.output, aligned.motion)
        past, valid = past.clamp(min=0), aligned.valid & found
        moments = usable_moments(frame, "color")
        width: Tensor | float = 1.0
        if guides is not None and state.guides is not None:
            apart = (guides.image - warp(state.guides.image, aligned.motion).image).abs()
            apart = torch.maximum(apart[:, :3].mean(1, keepdim=True), apart[:, 3:].mean(1, keepdim=True))
            width = LOOSE + (TIGHT - LOOSE) * (apart / _DIFFERENT).clamp(max=1)
        history = clamp_history(past, moments._replace(deviation=moments.deviation * width))
        # The paper's α is the weight of history, and its mask is inverted here: α′ = α·m. Here alpha is the weight of
        # the current frame.
        blended = torch.where(valid, torch.lerp(history, current, 1 - (1 - self.options.alpha) * mask), current)
        return keep_where_bad(blended, past, valid, frame, "color"), valid
