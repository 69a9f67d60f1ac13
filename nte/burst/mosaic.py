"""The colour filter array of a sensor: the colour of each pixel, comparable blocks, and matching pixels."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
import torch
import torch.nn.functional as F
from torch import Tensor

from nte.errors import NteError
from nte.motion.warp import inside, pixel_centres

_FINE = 8  # positions within a pixel, along each axis, for which the nearest pixel of a colour is tabulated
_REACH = 2  # px: radius of the search for it; in Bayer and X-Trans arrays one is nearer


@dataclass(frozen=True)
class Mosaic:
    """A periodic colour filter array: the colour (0 red, 1 green, 2 blue) of each pixel of one period, row by row.

    Raises NteError for an array that is not 2×2 (Bayer) or 6×6 (X-Trans) with all three colours.
    """

    rows: tuple[tuple[int, ...], ...]

    def __post_init__(self) -> None:
        shape = len(self.rows), *{len(row) for row in self.rows}
        if shape not in ((2, 2), (6, 6)) or {colour for row in self.rows for colour in row} != {0, 1, 2}:
            found = " ".join("".join(map(str, row)) for row in self.rows)
            raise NteError(f"the sensor's colours are {found}: expected a 2x2 (Bayer) or 6x6 (X-Trans) array of three")
        assert self.origin is not None

    @property
    def period(self) -> int:
        """Number of pixels after which the colours repeat."""
        return len(self.rows)

    @property
    def block(self) -> int:
        """Side of the smallest square with the same share of each colour everywhere: 2 for Bayer, 3 for X-Trans."""
        return 2 if self.period == 2 else 3

    @cached_property
    def origin(self) -> tuple[int, int]:
        """(y, x) of the first whole block: an X-Trans image may start inside one."""
        pattern = np.tile(self.rows, (2, 2))
        for y in range(self.block):
            for x in range(self.block):
                window = pattern[y : y + self.period, x : x + self.period]
                blocks = window.reshape(-1, self.block, self.period // self.block, self.block).swapaxes(1, 2)
                counts = [np.bincount(one.ravel(), minlength=3).tolist() for one in blocks.reshape(-1, self.block**2)]
                if all(count == counts[0] for count in counts):
                    return y, x
        raise NteError("the sensor's 6x6 array has no 3x3 blocks of equal colours: expected X-Trans")

    def colours(self, height: int, width: int) -> Tensor:
        """Return the colour (H, W) int64 that each pixel sees: 0 red, 1 green, 2 blue."""
        repeats = -(-height // self.period), -(-width // self.period)
        return torch.from_numpy(np.tile(np.array(self.rows, np.int64), repeats))[:height, :width]

    def bin(self, image: Tensor) -> Tensor:
        """Average the whole blocks of a mosaic (N, 1, H, W) to grey values (N, 1, h, w)."""
        return F.avg_pool2d(image[..., self.origin[0] :, self.origin[1] :], self.block)

    def spread(self, motion: Tensor, height: int, width: int) -> Tensor:
        """Upsample motion (N, 2, h, w) in blocks to motion (N, 2, H, W) in pixels: bilinear, the border repeated."""
        large = F.interpolate(motion * self.block, scale_factor=self.block, mode="bilinear", align_corners=False)
        top, left = self.origin
        bottom, right = height - top - large.shape[-2], width - left - large.shape[-1]
        return F.pad(large, (left, right, top, bottom), mode="replicate")

    def fetch(self, image: Tensor, motion: Tensor) -> tuple[Tensor, Tensor]:
        """Fetch for each pixel x the pixel of the same colour nearest to x + motion(x).

        image: (1, 1, H, W). motion: (1, 2, H, W) in pixels. Returns the fetched values (1, 1, H, W), and a bool mask
        (1, 1, H, W) of those that lie inside the image. No two pixels are mixed, so noise stays independent, and a
        motion by whole periods copies. Otherwise the fetched pixel is off by up to 1 px (green) or 1.5 px.
        """
        height, width = image.shape[-2:]
        position = pixel_centres(image) + motion
        valid = inside(position)
        fine = (position * _FINE).floor().long()
        x = fine[0, 0].clamp(0, width * _FINE - 1)
        y = fine[0, 1].clamp(0, height * _FINE - 1)
        turn = self.period * _FINE
        place = self._steps[:, self.colours(height, width).to(image.device), y % turn, x % turn]
        x = x.div(_FINE, rounding_mode="floor") + place[1]
        y = y.div(_FINE, rounding_mode="floor") + place[0]
        valid = valid & (x >= 0) & (x < width) & (y >= 0) & (y < height)
        return image[..., y.clamp(0, height - 1), x.clamp(0, width - 1)], valid

    @cached_property
    def _steps(self) -> Tensor:
        """Table (2, 3, T, T): the step (y, x) from each position's pixel to the nearest pixel of a colour."""
        turn = self.period * _FINE
        centre = np.arange(turn) / _FINE + 0.5 / _FINE  # centre of the position's cell
        pixel = np.arange(turn) // _FINE
        pattern = np.array(self.rows)
        nearest = np.full((3, turn, turn), np.inf)
        steps = np.zeros((2, 3, turn, turn), np.int64)
        for dy in range(-_REACH, _REACH + 1):
            for dx in range(-_REACH, _REACH + 1):
                y, x = pixel + dy, pixel + dx
                distance = (y + 0.5 - centre)[:, None] ** 2 + (x + 0.5 - centre)[None] ** 2
                seen = pattern[np.ix_(y % self.period, x % self.period)]
                for colour in range(3):
                    closer = (seen == colour) & (distance < nearest[colour] - 1e-9)
                    nearest[colour][closer] = distance[closer]
                    steps[0, colour][closer], steps[1, colour][closer] = dy, dx
        return torch.from_numpy(steps)


def pattern_of(colours: npt.NDArray[np.integer], names: str) -> Mosaic:
    """Find the colour filter array of a sensor from its pixels' colour numbers (H, W).

    names: the letter of each colour number; in "RGBG" both greens are one colour. Raises NteError if the colours do
    not repeat every 2 or 6 pixels.
    """
    numbers = np.array(["RGB".find(name) for name in names])
    for period in (2, 6):
        first = colours[:period, :period]
        repeats = -(-np.array(colours.shape) // period)
        if np.array_equal(np.tile(first, repeats)[: colours.shape[0], : colours.shape[1]], colours):
            return Mosaic(tuple(tuple(int(numbers[value]) for value in row) for row in first))
    raise NteError("the sensor's colours do not repeat every 2 or 6 pixels: expected a Bayer or X-Trans sensor")
