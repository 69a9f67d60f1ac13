"""TAA accumulation, the «traditional» baseline: an exponential mean along motion vectors.

With clamping to the neighbourhood of the current frame (Salvi 2015, «An Excursion in Temporal
Supersampling»), clipping, or nothing.
"""

from typing import Any

import torch

from nte.denoiser import Denoiser, Result, check_size, sanitised
from nte.errors import NteError
from nte.filters.blocks import (
    accumulate,
    clamp_history,
    clip_history,
    fetch_history,
    keep_where_bad,
    neighbourhood_moments,
    remembered,
)
from nte.filters.composition import check_target
from nte.frames.frame import Frame
from nte.motion.geometric import traditional_motion

CLAMPS = ("none", "clamp", "clip")


class Taa(Denoiser):
    """Temporal accumulation of `color`, or of one light component (`target`), with bilinear history.

    target `components`: each component by itself (Composition).
    clamp: what happens to history outside μ ± σ of the current 3×3 neighbourhood: `none`, `clamp` (per
    channel) or `clip` (along the line to μ). alpha: weight of the current frame, in (0, 1].
    """

    optional: tuple[str, ...] = ()

    def __init__(self, clamp: str = "clamp", alpha: float = 0.1, target: str = "color", device: str = "cpu") -> None:
        check_target("taa", target)
        if clamp not in CLAMPS:
            raise NteError(f"taa: clamp is '{clamp}', expected one of {', '.join(CLAMPS)}")
        if not 0 < alpha <= 1:
            raise NteError(f"taa: alpha is {alpha}, expected a weight of the current frame in (0, 1]")
        self.clamp, self.alpha, self.target, self.device = clamp, alpha, target, device
        self.needs: tuple[str, ...] = (target, "motion")

    @sanitised
    def step(self, frame: Frame, state: Any, extras: tuple[str, ...] = ()) -> tuple[Result, Any]:
        """Blend the frame into the history, which is the state: the previous output (N, C, H, W)."""
        tensors = frame.torch(self.device)
        current = tensors[self.target]
        output, valid = current, torch.zeros_like(current[:, :1], dtype=torch.bool)
        if state is not None:
            check_size(frame, state)
            history, valid = fetch_history(state, traditional_motion(tensors["motion"]), tensors.reset)
            limited = history
            if self.clamp != "none":
                limit = clamp_history if self.clamp == "clamp" else clip_history
                limited = limit(history, neighbourhood_moments(current))
            output = accumulate(current, limited, valid, self.alpha)
            output = keep_where_bad(output, history, valid, tensors, self.target)
        return Result(output).like(frame), remembered(output, valid, tensors, self.target)
