"""«A Reconstruction Filter for Plausible Motion Blur» (McGuire, Hennessy, Bukowski and Osman 2012).

A post-process on sharp frames that also blurs moving objects beyond their outlines. The dominant vector of the
neighbourhood tells where to look, and depth and speed of two pixels tell which of them blurs over the other. Serves for
comparison with `motion_blur`.
"""

from dataclasses import dataclass
from typing import Annotated

import torch
import torch.nn.functional as F
from torch import Tensor

from nte.denoiser import Filter, Result, State, sanitised
from nte.filters.noise import uniform_noise
from nte.frames.frame import Frame
from nte.motion.warp import fetch_nearest, inside, pixel_centres
from nte.options import Allowed, Count, Options

_SKY = 1e20  # scene units; beyond all depths that are usable
STILL_PX = 0.5  # a dominant half vector no longer than this leaves the pixel as it is


@dataclass(frozen=True)
class McGuireOptions(Options, name="mcguire"):
    """Options of the reconstruction filter.

    samples: number of fetches (S) along the dominant vector. tile: side K, px, of the tiles in which the dominant
    vector is found, and the length at which half vectors are cut off. extent: depth difference over which one surface
    is taken to be in front of another, as a share of the smaller depth.
    """

    samples: Count = 15
    tile: Count = 20
    extent: Annotated[float, Allowed("a number above 0", lambda x: x > 0)] = 0.02


class McGuire(Filter[McGuireOptions]):
    """The reconstruction filter, for sharp frames (`sharp/` of a recipe with a shutter).

    `shutter_motion` is in px over the open shutter. Half vectors are at most a tile long, and count as at least half a
    pixel in comparisons.
    """

    needs: tuple[str, ...] = ("color", "depth", "shutter_motion")
    options_type = McGuireOptions

    @sanitised
    def step(self, frame: Frame, state: State, extras: tuple[str, ...] = ()) -> tuple[Result, State]:
        """Blur one frame; the filter has no state."""
        color, depth = frame["color"], frame["depth"]
        # The sky is infinitely far; with a finite depth the difference of two sky pixels is 0, not NaN.
        depth = torch.where(depth > 0, depth, _SKY)
        half = _limited(frame["shutter_motion"].nan_to_num(0, 0, 0) / 2, self.options.tile)
        dominant = dominant_motion(half, self.options.tile)
        blurred = self._gather(color, depth, half, dominant, frame.index)
        moves = _length(dominant) > STILL_PX
        return Result(torch.where(moves, blurred, color)), ()

    def _gather(self, color: Tensor, depth: Tensor, half: Tensor, dominant: Tensor, index: int) -> Tensor:
        """The third pass: the weighted mean of samples along the dominant vector."""
        speed = _length(half).clamp(min=0.5)
        places = pixel_centres(color)
        jitter = uniform_noise(color.shape[-2], color.shape[-1], index, 1, color.device) - 0.5
        weights = 1 / speed
        total = color * weights
        packed = torch.cat([color, depth, speed], 1)
        samples, extent = self.options.samples, self.options.extent
        for number in range(samples):
            if 2 * number + 1 == samples:
                continue  # the middle sample is the pixel itself, which is counted already
            place = (places + dominant * (2 * (number + jitter + 0.5) / samples - 1)).floor() + 0.5
            found = fetch_nearest(packed, place)
            there, behind, fast = found[:, :3], found[:, 3:4], found[:, 4:]
            apart = _length(place - places)
            before = _in_front(behind, depth, extent)
            after = _in_front(depth, behind, extent)
            weight = (
                before * _cone(apart, fast)
                + after * _cone(apart, speed)
                + 2 * _cylinder(apart, fast) * _cylinder(apart, speed)
            ) * inside(place)
            total = total + weight * there
            weights = weights + weight
        return total / weights


def dominant_motion(half: Tensor, tile: int) -> Tensor:
    """Find the longest half vector (N, 2, H, W) in each pixel's tile (TileMax) and the eight around it (NeighborMax).

    half (N, 2, H, W): half vectors, px. tile: side of a tile, px.
    """
    height, width = half.shape[-2:]
    padded = F.pad(half, (0, -width % tile, 0, -height % tile))
    rows, columns = padded.shape[-2] // tile, padded.shape[-1] // tile
    tiles = padded.view(len(half), 2, rows, tile, columns, tile).transpose(3, 4).flatten(4)
    largest = _longest(tiles)
    around = F.unfold(largest, 3, padding=1).view(len(half), 2, 9, rows, columns).movedim(2, -1)
    chosen = _longest(around)
    return chosen.repeat_interleave(tile, 2).repeat_interleave(tile, 3)[..., :height, :width]


def _longest(vectors: Tensor) -> Tensor:
    """The longest of T vectors, (N, 2, …) out of (N, 2, …, T)."""
    index = vectors.square().sum(1, keepdim=True).argmax(-1, keepdim=True)
    return vectors.gather(-1, index.expand(-1, 2, *(-1,) * (index.ndim - 2)))[..., 0]


def _limited(vectors: Tensor, longest: float) -> Tensor:
    return vectors * (longest / _length(vectors).clamp(min=longest))


def _length(vectors: Tensor) -> Tensor:
    return vectors.square().sum(1, keepdim=True).sqrt()


def _in_front(a: Tensor, b: Tensor, extent: float) -> Tensor:
    """A soft depth comparison: 1 where a is not behind b, 0 where it is behind by the extent or more."""
    return (1 - (a - b) / (extent * torch.minimum(a, b))).clamp(0, 1)


def _cone(apart: Tensor, speed: Tensor) -> Tensor:
    return (1 - apart / speed).clamp(0, 1)


def _cylinder(apart: Tensor, speed: Tensor) -> Tensor:
    """1 inside the blur of this half length, with a soft end: 1 − smoothstep(0.95 v, 1.05 v)."""
    place = ((apart - 0.95 * speed) / (0.1 * speed)).clamp(0, 1)
    return 1 - place * place * (3 - 2 * place)
