"""Bright bars on black in closed form, that move, grow and shrink: what becomes of their light in a blurred frame?"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from nte.frames.frame import Frame

Pixels = npt.NDArray[np.float32]
_STRATA = 64  # times over the shutter of which the truth is the mean


@dataclass(frozen=True)
class Bar:
    """A bar whose middle is in the image's at time 0; lengths in px, x to the right, y down.

    size: along its own axes, which are turned by `angle` (radians, x towards y). velocity: px a frame. growth: share
    of its size that it gains in a frame (negative: what is seen converges). stripes: period of a pattern of its
    colour along its first axis; 0: one colour.
    """

    size: tuple[float, float] = (10.0, 60.0)
    velocity: tuple[float, float] = (20.0, 0.0)
    angle: float = 0.0
    growth: float = 0.0
    color: tuple[float, float, float] = (8.0, 8.0, 8.0)
    stripes: float = 0.0
    image: tuple[int, int] = (96, 128)
    shutter: float = 1.0

    def frame(self, index: int, seed: int = 0, batch: int = 1) -> Frame:
        """Frame `index`: one sample per pixel, at a random time of the shutter, (N, C, H, W).

        The N times of a pixel are spread evenly over the shutter, so that the mean of the batch is all but the truth.
        """
        time = np.random.default_rng((seed, index + 100)).random(self.image)
        time = (time + np.arange(batch)[:, None, None] / batch) % 1
        color, motion, inside = self._seen(index, time)
        channels = {
            "color": color,
            "time": time[:, None],
            "shutter_motion": motion,
            "shutter_depth": np.where(inside, 3.0, 5.0)[:, None],
        }
        arrays = {name: values.astype(np.float32) for name, values in channels.items()}
        return Frame(arrays, index, shutter=np.full(batch, self.shutter, np.float32))

    def truth(self, index: int) -> Pixels:
        """(3, H, W): the blurred frame."""
        times = (np.arange(_STRATA) + 0.5) / _STRATA
        return np.mean([self._seen(index, np.full((1, *self.image), t))[0][0] for t in times], 0).astype(np.float32)

    def _seen(self, index: int, time: npt.NDArray[np.float64]) -> tuple[npt.NDArray[np.float64], ...]:
        """Colour (N, 3, H, W), vector over the shutter (N, 2, H, W) and whether the bar is seen (N, H, W)."""
        now = index + self.shutter * (time - 0.5)
        place = self._places - now[..., None] * np.array(self.velocity)
        scale = (1 + self.growth * now)[..., None]
        cos, sin = np.cos(self.angle), np.sin(self.angle)
        own = place / scale @ np.array([[cos, -sin], [sin, cos]])
        inside = (np.abs(own) < np.array(self.size) / 2).all(-1)
        motion = self.shutter * (np.array(self.velocity) + place / scale * self.growth)
        pattern = 1 + 0.9 * np.sin(own[..., 0] * 2 * np.pi / self.stripes) if self.stripes else np.ones_like(now)
        color = (pattern * inside)[:, None] * np.reshape(self.color, (3, 1, 1))
        return color, np.where(inside[..., None], motion, 0).transpose(0, 3, 1, 2), inside

    @cached_property
    def _places(self) -> npt.NDArray[np.float64]:
        y, x = np.meshgrid(*(np.arange(length) + 0.5 for length in self.image), indexing="ij")
        return np.stack([x - self.image[1] / 2, y - self.image[0] / 2], -1)
