"""«A Reconstruction Filter for Plausible Motion Blur» (McGuire, Hennessy, Bukowski and Osman 2012).

A post-process on sharp frames that also spreads what moves outwards: the dominant vector of the neighbourhood says
where to look, and depth and speed of the two pixels say which of them blurs over the other. A comparator of
`motion_blur`.
"""

from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor

from nte.denoiser import Denoiser, Result, sanitised
from nte.errors import NteError
from nte.filters.noise import uniform_noise
from nte.frames.frame import Frame
from nte.motion.warp import fetch_nearest, inside, pixel_centres

STILL_PX = 0.5  # a dominant half vector no longer than this leaves the pixel as it is


class McGuire(Denoiser):
    """The filter with `samples` fetches (S) along the dominant vector of tiles of `tile`×`tile` pixels (K).

    Half vectors are as long as `tile` at most, and half a pixel at least in the comparisons. extent: depth over which
    one surface is taken to be before another, as a share of the pixel's depth. Reads sharp frames (`sharp/` of a recipe
    with a shutter). Raises NteError for options out of range.
    """

    needs: tuple[str, ...] = ("color", "depth", "shutter_motion")
    optional: tuple[str, ...] = ()
    target = "color"

    def __init__(self, samples: int = 15, tile: int = 20, extent: float = 0.02, device: str = "cpu") -> None:
        for key, number in (("samples", samples), ("tile", tile), ("extent", extent)):
            if not number > 0:
                raise NteError(f"mcguire: {key} is {number}, expected a number above 0")
        self.samples, self.tile, self.extent, self.device = samples, tile, extent, device

    @sanitised
    def step(self, frame: Frame, state: Any, extras: tuple[str, ...] = ()) -> tuple[Result, Any]:
        """Blur one frame; it has no state."""
        tensors = frame.torch(self.device)
        color, depth = tensors["color"], tensors["depth"]
        # Sky is infinitely far; a finite number keeps differences of two of them 0.
        depth = torch.where(depth > 0, depth, 1e8)
        half = _limited(tensors["shutter_motion"].nan_to_num(0, 0, 0) / 2, self.tile)
        dominant = dominant_motion(half, self.tile)
        blurred = self._gather(color, depth, half, dominant, frame.index)
        moves = _length(dominant) > STILL_PX
        return Result(torch.where(moves, blurred, color)).like(frame), ()

    def _gather(self, color: Tensor, depth: Tensor, half: Tensor, dominant: Tensor, index: int) -> Tensor:
        """The third pass: the weighted mean along the dominant vector."""
        speed = _length(half).clamp(min=0.5)
        places = pixel_centres(color)
        jitter = uniform_noise(color.shape[-2], color.shape[-1], index, 1, color.device) - 0.5
        weights = 1 / speed
        total = color * weights
        packed = torch.cat([color, depth, speed], 1)
        for number in range(self.samples):
            if 2 * number + 1 == self.samples:
                continue  # the pixel itself, which has been counted
            place = (places + dominant * (2 * (number + jitter + 0.5) / self.samples - 1)).floor() + 0.5
            found = fetch_nearest(packed, place)
            there, behind, fast = found[:, :3], found[:, 3:4], found[:, 4:]
            apart = _length(place - places)
            before = _in_front(behind, depth, self.extent)
            after = _in_front(depth, behind, self.extent)
            weight = (
                before * _cone(apart, fast) + after * _cone(apart, speed)
                + 2 * _cylinder(apart, fast) * _cylinder(apart, speed)
            ) * inside(place)  # fmt: skip
            total = total + weight * there
            weights = weights + weight
        return total / weights


def dominant_motion(half: Tensor, tile: int) -> Tensor:
    """(N, 2, H, W): the longest half vector in the pixel's tile (TileMax) and the eight around it (NeighborMax)."""
    height, width = half.shape[-2:]
    padded = F.pad(half, (0, -width % tile, 0, -height % tile))
    rows, columns = padded.shape[-2] // tile, padded.shape[-1] // tile
    tiles = padded.view(len(half), 2, rows, tile, columns, tile).transpose(3, 4).flatten(4)
    largest = _longest(tiles)
    around = F.unfold(largest, 3, padding=1).view(len(half), 2, 9, rows, columns).movedim(2, -1)
    chosen = _longest(around)
    return chosen.repeat_interleave(tile, 2).repeat_interleave(tile, 3)[..., :height, :width]


def _longest(vectors: Tensor) -> Tensor:
    """(N, 2, …) of (N, 2, …, T): the longest of T vectors."""
    index = vectors.square().sum(1, keepdim=True).argmax(-1, keepdim=True)
    return vectors.gather(-1, index.expand(-1, 2, *(-1,) * (index.ndim - 2)))[..., 0]


def _limited(vectors: Tensor, longest: float) -> Tensor:
    return vectors * (longest / _length(vectors).clamp(min=longest))


def _length(vectors: Tensor) -> Tensor:
    return vectors.square().sum(1, keepdim=True).sqrt()


def _in_front(a: Tensor, b: Tensor, extent: float) -> Tensor:
    """Soft depth comparison: 1 where a is not behind b, 0 where it is by the extent."""
    return (1 - (a - b) / (extent * torch.minimum(a, b))).clamp(0, 1)


def _cone(apart: Tensor, speed: Tensor) -> Tensor:
    return (1 - apart / speed).clamp(0, 1)


def _cylinder(apart: Tensor, speed: Tensor) -> Tensor:
    """1 inside the blur of this half length, with a soft end: 1 − smoothstep(0.95 v, 1.05 v)."""
    place = ((apart - 0.95 * speed) / (0.1 * speed)).clamp(0, 1)
    return 1 - place * place * (3 - 2 * place)
