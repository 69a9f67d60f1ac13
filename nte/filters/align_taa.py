"""Temporal antialiasing of images without Monte Carlo noise, along correspondences found in the images alone.

Hanika, Tessari and Dachsbacher 2021, «Fast Temporal Reprojection without Motion Vectors», sections 3.2 and 4.
"""

from typing import Any, NamedTuple

import torch
from torch import Tensor

from nte.denoiser import Denoiser, Result, check_size, sanitised
from nte.errors import NteError
from nte.filters.align import Aligned, align, check_motion, check_range, chooser
from nte.filters.blocks import clamp_history, keep_where_bad, neighbourhood_moments, remembered, restarts
from nte.filters.estimated import AUTO, matched_grey
from nte.frames.frame import Frame
from nte.frames.scalars import sequence_exposure
from nte.frames.usable import mask_of
from nte.motion.catmull_rom import warp_catmull_rom
from nte.motion.correspondence import rejection_mask
from nte.motion.warp import warp

EXTRAS = ("motion", "mask")
LOOSE, TIGHT = 2.0, 0.5  # σ allowed where albedo and normal agree (a shadow moved), and where they do not
_DIFFERENT = 0.1  # of albedo or normal, mean over its components: the tolerance is TIGHT from there on


class _State(NamedTuple):
    output: Tensor  # (N, 3, H, W)
    searched: Tensor  # (N, C, H, W) what the search compares: displayed grey, or albedo and normal
    guides: Tensor | None  # (N, 6, H, W) albedo and normal, where the tolerance is adaptive
    exposure: Tensor  # (N,)


class AlignTaa(Denoiser):
    """TAA without motion vectors: history is fetched with Catmull–Rom and clamped to μ ± σ of 3×3 pixels.

    The mask m = κ ε − η of the patch distance is used inverted: history counts where m is large, at edges and where
    things change, and flat areas are left alone. motion: `estimate` (the paper), `zero` or `geometric`. guides: search
    in albedo and normal, which have no noise, instead of the image. tolerance: `fixed` (1 σ), or `adaptive`: 2 σ,
    down to 0.5 σ where the albedo or normal that history lies on differs. alpha: weight of the current frame where
    m is 1. noise, radii: of the search, as in align_accumulate. Extras: `motion` and `mask`.
    """

    extras: tuple[str, ...] = EXTRAS

    optional: tuple[str, ...] = ()
    target = "color"

    def __init__(
        self, motion: str = "estimate", guides: bool = False, tolerance: str = "fixed", kappa: float = 40.0,
        eta: float = 0.0, alpha: float = 0.1, noise: str = AUTO, radii: str = "", device: str = "cpu",
    ) -> None:  # fmt: skip
        check_motion("align_taa", motion)
        check_range("align_taa", alpha=alpha, kappa=kappa, eta=eta)
        if tolerance not in ("fixed", "adaptive"):
            raise NteError(f"align_taa: tolerance is '{tolerance}', expected fixed or adaptive")
        self.motion, self.guides, self.tolerance, self.device = motion, guides, tolerance, device
        self.kappa, self.eta, self.alpha, self.choose = kappa, eta, alpha, chooser(noise, radii)
        looks = ["albedo", "normal"] if guides or tolerance == "adaptive" else []
        self.needs: tuple[str, ...] = ("color", *looks, *(["motion"] if motion == "geometric" else []))

    @sanitised
    def step(self, frame: Frame, state: Any, extras: tuple[str, ...] = ()) -> tuple[Result, Any]:
        """Blend the frame with its history, the previous output, which is the state with what was searched."""
        tensors = frame.torch(self.device)
        current = tensors["color"]
        carried = None if state is None else state.exposure
        exposure = torch.from_numpy(sequence_exposure(frame, carried)).to(current)
        guides = None
        if "albedo" in self.needs:
            guides = torch.cat([tensors["albedo"], tensors["normal"]], 1)
        searched = guides if self.guides and guides is not None else matched_grey(current, exposure)
        output, valid = current, torch.zeros_like(current[:, :1], dtype=torch.bool)
        mask = torch.zeros_like(current[:, :1])
        aligned = Aligned(current.new_zeros(frame.batch, 2, *frame.size), mask > 0, mask)
        if state is not None:
            check_size(frame, state.output)
            starts = restarts(tensors)
            if not self.guides:
                searched = torch.where((tensors[mask_of("color")] > 0) | starts, searched, state.searched)
            aligned = align(searched, state.searched, tensors, self.motion, self.choose)
            aligned = aligned._replace(motion=torch.where(starts, 0.0, aligned.motion), valid=aligned.valid & ~starts)
            mask = torch.where(starts, 0.0, rejection_mask(aligned.error, self.kappa, self.eta))
            output, valid = self._blend(current, mask, aligned, guides, state, tensors)
        found = {"motion": aligned.motion, "mask": mask}
        result = Result(output, {name: found[name] for name in extras}).like(frame)
        return result, _State(remembered(output, valid, tensors, "color"), searched, guides, exposure)

    def _blend(
        self, current: Tensor, mask: Tensor, aligned: Aligned, guides: Tensor | None, state: _State, frame: Frame
    ) -> tuple[Tensor, Tensor]:  # fmt: skip
        """(image, where it has a history)."""
        past = warp_catmull_rom(state.output, aligned.motion).image.clamp(min=0)
        valid = aligned.valid & past.isfinite().all(1, keepdim=True)
        moments = neighbourhood_moments(current)
        width: Tensor | float = 1.0
        if self.tolerance == "adaptive" and guides is not None and state.guides is not None:
            apart = (guides - warp(state.guides, aligned.motion).image).abs()
            apart = torch.maximum(apart[:, :3].mean(1, keepdim=True), apart[:, 3:].mean(1, keepdim=True))
            width = LOOSE + (TIGHT - LOOSE) * (apart / _DIFFERENT).clamp(max=1)
        history = clamp_history(past, moments._replace(deviation=moments.deviation * width))
        # The paper's α weights history, and here the mask is inverted: α′ = α·m. Ours weights the current frame.
        blended = torch.where(valid, torch.lerp(history, current, 1 - (1 - self.alpha) * mask), current)
        return keep_where_bad(blended, past, valid, frame, "color"), valid
