"""Simple motion blur of a sharp frame, along each pixel's own vector (Rosado 2007; Ritchie et al. 2010).

«Motion Blur as a Post-Processing Effect», GPU Gems 3; «Split Second Motion Blur». A comparator of `motion_blur`: it
blurs what moves inwards only, and cannot know what is behind.
"""

from typing import Any

import torch

from nte.denoiser import Denoiser, Result, sanitised
from nte.errors import NteError
from nte.frames.frame import Frame
from nte.motion.warp import warp


class PostBlur(Denoiser):
    """The mean of `samples` bilinear fetches of `color`, spread evenly over the vector, which the pixel halves.

    Reads sharp frames (`sharp/` of a recipe with a shutter); `shutter_motion` is px over the open shutter. Fetches
    outside the image do not count. Raises NteError where samples is below 1.
    """

    needs: tuple[str, ...] = ("color", "shutter_motion")
    optional: tuple[str, ...] = ()
    target = "color"

    def __init__(self, samples: int = 15, device: str = "cpu") -> None:
        if samples < 1:
            raise NteError(f"post_blur: samples is {samples}, expected 1 or more")
        self.samples, self.device = samples, device

    @sanitised
    def step(self, frame: Frame, state: Any, extras: tuple[str, ...] = ()) -> tuple[Result, Any]:
        """Blur one frame; it has no state."""
        tensors = frame.torch(self.device)
        color, motion = tensors["color"], tensors["shutter_motion"].nan_to_num(0, 0, 0)
        total, count = torch.zeros_like(color), torch.zeros_like(color[:, :1])
        for number in range(self.samples):
            fetched, inside = warp(color, motion * ((number + 0.5) / self.samples - 0.5))
            total += fetched * inside
            count += inside
        moves = (motion != 0).any(1, keepdim=True) & (count > 0)
        return Result(torch.where(moves, total / count.clamp(min=1), color)).like(frame), ()
