"""Accumulation of Monte Carlo renderings along correspondences that are found in the images alone.

Hanika, Tessari and Dachsbacher 2021, «Fast Temporal Reprojection without Motion Vectors», sections 3.2 and 4.
"""

from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import torch
from torch import Tensor

from nte.color import demodulate, remodulate
from nte.denoiser import Filter, Result, State, sanitised
from nte.filters.align import SearchOptions, align
from nte.filters.blocks import fetch_history, keep_where_bad, remembered, restarts, texture_of
from nte.filters.estimated import Chooser, Seen, look
from nte.frames.frame import Frame
from nte.frames.usable import mask_of
from nte.motion.correspondence import rejection_mask
from nte.motion.geometric import Reprojection
from nte.motion.patch_distance import Norm


class _State(NamedTuple):
    merged: Tensor  # (N, 3, H, W) the frames merged so far, demodulated if so configured
    length: Tensor  # (N, 1, H, W) the number of merged frames
    seen: Seen  # the frame, as the search compares it


@dataclass(frozen=True)
class AlignAccumulateOptions(SearchOptions, name="align_accumulate"):
    """Options of `align_accumulate`: those of the search, and its own.

    norm: of the patch distance; the paper uses log L1ᶜ, which is `log_centred`. demodulate: search and merge light
    divided by albedo, indirect light by diffuse_albedo, and multiply the result by it. target: the channel to denoise.
    """

    norm: Norm = "log_centred"
    demodulate: bool = False
    target: Literal["color", "indirect", "glossy"] = "color"

    def chooser(self) -> Chooser:
        """Return the chooser of the search for this noise, with this norm and these radii."""
        chosen = super().chooser()
        return replace(chosen, changes={**chosen.changes, "norm": self.norm})


class AlignAccumulate(Filter[AlignAccumulateOptions]):
    """An exponential mean of the target channel along correspondences, without any clamping of history.

    The weight of the current frame is 1/n for the nth frame of a history, and at least alpha; frames in which the pixel
    was bad do not count. Extras: `motion`, `mask` (m) and `history_length`.
    """

    options_type = AlignAccumulateOptions
    extras = ("motion", "mask", "history_length")

    def __init__(self, options: AlignAccumulateOptions | None = None, *, device: str = "cpu") -> None:
        super().__init__(options, device=device)
        how = self.options
        self.target, self.choose = how.target, how.chooser()
        vectors, texture = ["motion"] if how.motion == "geometric" else [], ["albedo"] if how.demodulate else []
        self.needs = tuple(dict.fromkeys([how.target, "color", *vectors, *texture]))
        self.optional = ("diffuse_albedo",) if how.demodulate and how.target == "indirect" else ()

    @sanitised
    def step(self, frame: Frame, state: State, extras: tuple[str, ...] = ()) -> tuple[Result, State]:
        """Merge the frame into the history; the state holds the merged image and the image that was searched."""
        how = self.options
        albedo = texture_of(frame, self.target) if how.demodulate else None
        current = frame[self.target]
        current = current if albedo is None else demodulate(current, albedo)
        seen, before = look(frame, (self.target,), state and state.seen, current)
        merged, length = current, torch.ones_like(seen.image)
        kept = remembered(current, length < 1, frame, self.target)
        motion, mask = current.new_zeros(frame.batch, 2, *frame.size), torch.ones_like(length)
        if before is not None:
            starts = restarts(frame)
            usable = frame[mask_of(self.target)]
            motion, valid, error = align(seen.image, before, frame, how.motion, self.choose)
            motion = torch.where(starts, 0.0, motion)
            mask = torch.where(starts, 1.0, rejection_mask(error, how.kappa, how.eta))
            where = Reprojection(motion, valid, torch.zeros_like(valid))
            past, valid = fetch_history(torch.cat([state.merged, state.length], 1), where, frame.reset)
            # The paper's α is the weight of history: α′ = α (1 − m). Here alpha is the weight of the current frame.
            length = torch.where(valid, usable + past[:, 3:] * (1 - mask), 1.0)
            weight = 1 - (1 - (1 / length).clamp(how.alpha, 1)) * (1 - mask)
            merged = torch.where(valid, torch.lerp(past[:, :3], current, weight), current)
            merged = keep_where_bad(merged, past[:, :3], valid, frame, self.target)
            kept = remembered(merged, valid, frame, self.target)
        image = merged if albedo is None else remodulate(merged, albedo)
        found = {"motion": motion, "mask": mask, "history_length": length.clone()}  # the state keeps the other
        result = Result(image, {name: found[name] for name in extras})
        return result, _State(kept, length, seen)
