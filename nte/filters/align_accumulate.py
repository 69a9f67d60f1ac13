"""Accumulation of Monte Carlo renderings along correspondences that are found in the images alone.

Hanika, Tessari and Dachsbacher 2021, «Fast Temporal Reprojection without Motion Vectors», sections 3.2 and 4.
"""

from typing import Any, NamedTuple

import torch
from torch import Tensor

from nte.color import demodulate, remodulate
from nte.denoiser import Denoiser, Result, check_size, sanitised
from nte.errors import NteError
from nte.filters.align import align, check_motion, check_range, chooser
from nte.filters.blocks import fetch_history, keep_where_bad, remembered, restarts
from nte.filters.composition import check_target
from nte.filters.estimated import AUTO, matched_grey
from nte.frames.frame import Frame
from nte.frames.scalars import sequence_exposure
from nte.frames.usable import mask_of
from nte.motion.correspondence import rejection_mask
from nte.motion.geometric import Reprojection

EXTRAS = ("motion", "mask", "history_length")


class _State(NamedTuple):
    merged: Tensor  # (N, 3, H, W) what was merged so far, demodulated if asked for
    grey: Tensor  # (N, 1, H, W) of the frame before, as the search compares it
    length: Tensor  # (N, 1, H, W) how many frames are in it
    exposure: Tensor  # (N,)


class AlignAccumulate(Denoiser):
    """An exponential mean of `color` or `indirect` along correspondences, without any clipping of history.

    motion: `estimate` (the paper), `zero`, or `geometric` (the channel), with the same rejection each. noise: of
    the frames, which chooses the search: `auto` (measured), `clean`, `moderate`, `noisy` or `strong`. radii: of the
    patches instead, such as 10-4-2-2, finest first. norm: of the distance; the paper's is log L1ᶜ. kappa, eta:
    m = κ ε − η rejects. alpha: least weight of the current frame, in (0, 1]; 1/n for the nth frame of a history that is
    not longer than 1/alpha. demodulate: search and merge light without albedo, which is multiplied back. Extras:
    `motion`, `mask` (m) and `history_length`.
    """

    extras: tuple[str, ...] = EXTRAS

    optional: tuple[str, ...] = ()

    def __init__(
        self, motion: str = "estimate", noise: str = AUTO, radii: str = "", norm: str = "log_centred",
        kappa: float = 2.0, eta: float = 1.6, alpha: float = 0.1, demodulate: bool = False, target: str = "color",
        device: str = "cpu",
    ) -> None:  # fmt: skip
        check_motion("align_accumulate", motion)
        check_range("align_accumulate", alpha=alpha, kappa=kappa, eta=eta)
        check_target("align_accumulate", target)
        if target not in ("color", "indirect", "glossy"):
            raise NteError(f"align_accumulate: target is '{target}', expected color, indirect or glossy")
        self.motion, self.choose = motion, chooser(noise, radii, norm)
        self.kappa, self.eta, self.alpha, self.demodulate = kappa, eta, alpha, demodulate
        self.target, self.device = target, device
        self.needs: tuple[str, ...] = tuple(
            dict.fromkeys(
                [target, "color", *(["motion"] if motion == "geometric" else []), *(["albedo"] if demodulate else [])]
            )
        )

    @sanitised
    def step(self, frame: Frame, state: Any, extras: tuple[str, ...] = ()) -> tuple[Result, Any]:
        """Merge the frame into the history; the state is the merged image and what was searched."""
        tensors = frame.torch(self.device)
        albedo = tensors["albedo"] if self.demodulate else None
        current = tensors[self.target]
        current = current if albedo is None else demodulate(current, albedo)
        carried = None if state is None else state.exposure
        exposure = torch.from_numpy(sequence_exposure(frame, carried)).to(current)
        grey = matched_grey(current, exposure)
        merged, length = current, torch.ones_like(grey)
        kept = remembered(current, length < 1, tensors, self.target)
        motion, mask = current.new_zeros(frame.batch, 2, *frame.size), torch.ones_like(grey)
        if state is not None:
            check_size(frame, state.merged)
            starts = restarts(tensors)
            grey = torch.where((tensors[mask_of(self.target)] > 0) | starts, grey, state.grey)
            motion, valid, error = align(grey, state.grey, tensors, self.motion, self.choose)
            motion = torch.where(starts, 0.0, motion)
            mask = torch.where(starts, 1.0, rejection_mask(error, self.kappa, self.eta))
            where = Reprojection(motion, valid, torch.zeros_like(valid))
            past, valid = fetch_history(torch.cat([state.merged, state.length], 1), where, tensors.reset)
            # The paper's α weights history: α′ = α (1 − m). Ours weights the current frame.
            length = torch.where(valid, 1 + past[:, 3:] * (1 - mask), 1.0)
            weight = 1 - (1 - (1 / length).clamp(min=self.alpha)) * (1 - mask)
            merged = torch.where(valid, torch.lerp(past[:, :3], current, weight), current)
            merged = keep_where_bad(merged, past[:, :3], valid, tensors, self.target)
            kept = remembered(merged, valid, tensors, self.target)
        image = merged if albedo is None else remodulate(merged, albedo)
        found = {"motion": motion, "mask": mask, "history_length": length}
        result = Result(image, {name: found[name] for name in extras}).like(frame)
        return result, _State(kept, grey, length, exposure)
