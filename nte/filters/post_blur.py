"""Simple motion blur of a sharp frame, along each pixel's own vector (Rosado 2007; Ritchie et al. 2010).

«Motion Blur as a Post-Processing Effect», GPU Gems 3; «Split Second Motion Blur». Serves for comparison with
`motion_blur`: this filter blurs moving objects only within their outlines, and cannot show what is behind them.
"""

from dataclasses import dataclass

import torch

from nte.denoiser import Filter, Result, State, sanitised
from nte.frames.frame import Frame
from nte.motion.warp import warp
from nte.options import Count, Options


@dataclass(frozen=True)
class PostBlurOptions(Options, name="post_blur"):
    """Options of the simple motion blur.

    samples: number of fetches along the vector.
    """

    samples: Count = 15


class PostBlur(Filter[PostBlurOptions]):
    """The mean of `samples` bilinear fetches of `color`, spread evenly over a vector that is centred on the pixel.

    For sharp frames (`sharp/` of a recipe with a shutter). `shutter_motion` is in px over the open shutter. Fetches
    outside the image do not count.
    """

    needs: tuple[str, ...] = ("color", "shutter_motion")
    options_type = PostBlurOptions

    @sanitised
    def step(self, frame: Frame, state: State, extras: tuple[str, ...] = ()) -> tuple[Result, State]:
        """Blur one frame; the filter has no state."""
        color, motion = frame["color"], frame["shutter_motion"].nan_to_num(0, 0, 0)
        total, count = torch.zeros_like(color), torch.zeros_like(color[:, :1])
        samples = self.options.samples
        for number in range(samples):
            fetched, inside = warp(color, motion * ((number + 0.5) / samples - 0.5))
            total += fetched * inside
            count += inside
        moves = (motion != 0).any(1, keepdim=True) & (count > 0)
        return Result(torch.where(moves, total / count.clamp(min=1), color)), ()
