"""TAA accumulation, the «traditional» baseline: an exponential mean along motion vectors.

History is clamped to the neighbourhood of the current frame (Salvi 2015, «An Excursion in Temporal Supersampling»),
clipped to it, or left as it is.
"""

from dataclasses import dataclass
from typing import Literal

import torch

from nte.denoiser import Filter, Result, State, require_size, sanitised
from nte.filters.blocks import (
    accumulate,
    clamp_history,
    clip_history,
    fetch_history,
    keep_where_bad,
    remembered,
    usable_moments,
)
from nte.filters.composition import Target
from nte.frames.frame import Frame
from nte.motion.geometric import traditional_motion
from nte.options import Alpha, Options


@dataclass(frozen=True)
class TaaOptions(Options, name="taa"):
    """Options of TAA.

    clamp: what happens to history outside μ ± σ of the current 3×3 neighbourhood: `none`, `clamp` (per channel) or
    `clip` (along the line to μ). alpha: weight of the current frame, in (0, 1]. target: the channel to denoise;
    `components` denoises each light component separately (nte.filters.composition).
    """

    clamp: Literal["none", "clamp", "clip"] = "clamp"
    alpha: Alpha = 0.1
    target: Target = "color"


class Taa(Filter[TaaOptions]):
    """Temporal accumulation of `color` or of one light component (`target`), with bilinear fetching of history."""

    options_type = TaaOptions

    def __init__(self, options: TaaOptions | None = None, *, device: str = "cpu") -> None:
        super().__init__(options, device=device)
        self.target = self.options.target
        self.needs = (self.target, "motion")

    @sanitised
    def step(self, frame: Frame, state: State, extras: tuple[str, ...] = ()) -> tuple[Result, State]:
        """Blend the frame into the history; the state is the previous output (N, C, H, W)."""
        current = frame[self.target]
        output, valid = current, torch.zeros_like(current[:, :1], dtype=torch.bool)
        if state is not None:
            require_size(frame, state)
            history, valid = fetch_history(state, traditional_motion(frame["motion"]), frame.reset)
            limited = history
            if self.options.clamp != "none":
                limit = clamp_history if self.options.clamp == "clamp" else clip_history
                limited = limit(history, usable_moments(frame, self.target))
            output = accumulate(current, limited, valid, self.options.alpha)
            output = keep_where_bad(output, history, valid, frame, self.target)
        return Result(output), remembered(output, valid, frame, self.target)
