"""Any denoiser on frames without motion vectors: they are estimated from the images, by patch search.

Hanika, Tessari and Dachsbacher 2021, «Fast Temporal Reprojection without Motion Vectors».
"""

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from nte.color import display, luminance
from nte.denoiser import Denoiser, Result, State, check_size, sanitised
from nte.errors import NteError
from nte.frames.frame import Frame
from nte.frames.scalars import sequence_exposure
from nte.frames.usable import mask_of
from nte.motion.correspondence import SEARCHES, Search, find_correspondence

_TOLD_BY_OTHERS = ("motion", "forward_motion", "previous_forward_motion")  # vectors that would contradict ours


def matched_grey(color: Tensor, exposure: Tensor) -> Tensor:
    """What the search compares: displayed luminance (N, 1, H, W) in [0, 1] of radiance (N, 3, H, W); exposure (N,).

    An exposure of NaN, of a sequence without light so far, counts as 1.
    """
    return display(luminance(color), exposure.nan_to_num(1))


def search_for(noise: str) -> Search:
    """The search for images with this much noise: a name of SEARCHES. Raises NteError for others."""
    if noise not in SEARCHES:
        raise NteError(f"noise is '{noise}', expected one of {', '.join(SEARCHES)}")
    return SEARCHES[noise]


class _State(NamedTuple):
    grey: Tensor  # (N, 1, H, W) of the frame before
    exposure: Tensor  # (N,)
    inner: State


class EstimatedMotion:
    """A denoiser that gets `motion` from the images: `color` of this frame, searched in that of the frame before.

    denoiser: any; it sees the estimated vectors in place of given ones, and no others. noise: of the images, which
    sets the patches: `clean`, `moderate` (some 4 to 50 spp), `noisy` (1 spp) or `strong`. A sequence starts with no
    motion. The wrapped denoiser's extras are its own.
    """

    def __init__(self, denoiser: Denoiser, noise: str = "noisy") -> None:
        self.denoiser, self.search = denoiser, search_for(noise)
        self.target = denoiser.target
        self.components: tuple[str, ...] = getattr(denoiser, "components", ())
        self.needs: tuple[str, ...] = tuple(
            dict.fromkeys(["color", *(name for name in denoiser.needs if name not in _TOLD_BY_OTHERS)])
        )
        self.optional: tuple[str, ...] = tuple(name for name in denoiser.optional if name not in _TOLD_BY_OTHERS)

    @sanitised
    def step(self, frame: Frame, state: Any, extras: tuple[str, ...] = ()) -> tuple[Result, Any]:
        """Estimate the motion, then let the denoiser step; the state is its own and the image that was searched."""
        color = frame.torch()["color"]
        exposure = torch.from_numpy(sequence_exposure(frame, None if state is None else state.exposure)).to(color)
        grey = matched_grey(color, exposure)
        motion = color.new_zeros(frame.batch, 2, *frame.size)
        if state is not None:
            check_size(frame, state.grey)
            grey = torch.where(frame.torch()[mask_of("color")] > 0, grey, state.grey)
            motion = find_correspondence(grey, state.grey, self.search).motion
            if frame.reset is not None:
                starts = torch.as_tensor(np.asarray(frame.numpy().reset)).to(color.device) > 0
                motion[starts] = 0
        kept = {name: values for name, values in frame.channels.items() if name not in _TOLD_BY_OTHERS}
        given: Any = motion.cpu().numpy() if isinstance(frame["color"], np.ndarray) else motion
        result, inner = self.denoiser.step(
            replace(frame, channels={**kept, "motion": given}), None if state is None else state.inner, extras
        )
        return result, _State(grey, exposure, inner)
