"""The albedo of two consecutive frames, compared pixel by pixel along vectors.

A pixel finds its albedo in the previous frame, up to a pixel, if the value lies between the smallest and the largest
of the pixels around the place that its vector leads to. Only pixels inside one surface take part, and only if what they
fetch may be the same surface, as far as instance and depth can tell. Without both, the vectors themselves tell where
surfaces end.
"""

from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor

from nte.frames.frame import Frame
from nte.motion.warp import pixel_centres

ONE_SURFACE = 1.1  # greatest ratio of the depths in 3×3 pixels of one surface
ONE_MOTION = 1.0, 0.25  # greatest range of the vectors in 3×3 pixels of one surface: pixels, share of the longest one
SAME_SURFACE = 1.5  # greatest ratio between the depth of a pixel and the depth that it fetches
BEHIND = 1.02  # least ratio of the depths of two pixels that fetch the same one, the farther of which was hidden there


class Range(NamedTuple):
    """Smallest and largest albedo (3, H·W) around each pixel of the previous frame."""

    low: Tensor
    high: Tensor


class Textures:
    """Two consecutive frames as flat lists of pixels.

    previous, current: PyTorch frames of batch 1 with albedo and motion; instance and depth are optional.
    """

    def __init__(self, previous: Frame, current: Frame) -> None:
        self.height, self.width = current.size
        before = previous["albedo"].nan_to_num()
        self.albedo = current["albedo"].nan_to_num()[0].flatten(1)
        self.near = _range(F.pad(before, (0, 1, 0, 1), mode="replicate"), 2)  # range of the 4 pixels around a position
        self.wide = _range(F.pad(before, (1, 1, 1, 1), mode="replicate"), 3)  # range of the 3×3 pixels there
        now = current["albedo"].nan_to_num()
        self.before, self.around = before[0].flatten(1), _range(F.pad(now, (1, 1, 1, 1), mode="replicate"), 3)
        self.usable, self.usable_before = (_inside_surfaces(f).flatten() for f in (current, previous))
        both = [name for name in ("instance", "depth") if name in current and name in previous]
        self.surface = {name: (current[name].flatten(), previous[name].flatten()) for name in both}
        self.centres = pixel_centres(before)[0].flatten(1)

    def compare(self, pixels: Tensor, vectors: Tensor, found: Range) -> tuple[Tensor, Tensor]:
        """Return the albedo error (P,) of pixels (P,) with vectors (2, P), and a mask (P,): both ends in one surface.

        found: `near` or `wide`.
        """
        target, corner, within = self.target(self.centres[:, pixels] + vectors)
        return self.fetched(pixels, target, corner if found is self.near else target, within, found)

    def fetched(
        self, pixels: Tensor, target: Tensor, index: Tensor, within: Tensor, found: Range
    ) -> tuple[Tensor, Tensor]:
        """Return albedo error and mask, both (…, P), of pixels (P,) that fetch from the pixels `target` (…, P).

        index: (…, P), where `found` has the range of the albedo there; within: (…, P), the target lies in the image.
        """
        tells = within & _take(self.usable_before, target)
        if "instance" in self.surface:
            now, before = self.surface["instance"]
            tells = tells & (now[pixels] == _take(before, target))
        if "depth" in self.surface:
            now, before = self.surface["depth"]
            ratio = now[pixels] / _take(before, target)
            tells = tells & (ratio < SAME_SURFACE) & (ratio > 1 / SAME_SURFACE)
        return self.error(pixels, index, found), tells

    def error(self, pixels: Tensor, index: Tensor, found: Range) -> Tensor:
        """Return the albedo error (…, P) of pixels (P,) against the range that `found` has at `index` (…, P)."""
        return _outside(self.albedo[:, pixels], found, index)

    def error_back(self, pixels: Tensor, index: Tensor) -> Tensor:
        """Return the error (P,) of the previous albedo at `index` (P,) against the 3×3 pixels around `pixels` (P,)."""
        return _outside(self.before[:, index], self.around, pixels)

    def uncovered(self, vectors: Tensor) -> Tensor:
        """Tell which pixels (H·W,) vectors (2, H·W) declare uncovered: a nearer one comes from the same place.

        Instances and depth tell what a pixel fetches from what it shows, but often there are none, and things stand
        close before their background. Without depth all count that come from the place of one that moves otherwise.
        """
        target, _, within = self.target(self.centres + vectors)
        if "depth" not in self.surface:
            return within & self._contested(vectors, target, within)
        depth = self.surface["depth"][0]
        comes = within & (depth > 0)
        nearest = torch.full_like(depth, torch.inf)
        nearest.scatter_reduce_(0, target[comes], depth[comes], "amin")
        uncovered: Tensor = comes & (depth > BEHIND * _take(nearest, target))
        return uncovered

    def _contested(self, vectors: Tensor, target: Tensor, comes: Tensor) -> Tensor:
        """Tell which pixels (H·W,) lead to a target that another one reaches with a vector unlike theirs."""
        contested = torch.zeros_like(comes)
        for along in vectors:
            ends = [torch.full_like(along, sign * torch.inf) for sign in (1, -1)]
            for end, how in zip(ends, ("amin", "amax"), strict=True):
                end.scatter_reduce_(0, target[comes], along[comes], how)
            contested |= _take(ends[1] - ends[0], target) > ONE_MOTION[0]
        return contested

    def target(self, position: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Locate positions (2, P) in the image.

        Returns, each (P,): the flat index of the pixel that holds the position, the flat index of the upper left one
        of the four pixels whose centres are around it, and whether the position lies in the image.
        """
        place = position.nan_to_num(-1, -1, -1).clamp(-1, 2**20)
        (x, y), (left, top) = place.floor().long(), (place - 0.5).floor().long().clamp(min=0)
        within = (x >= 0) & (x < self.width) & (y >= 0) & (y < self.height)
        return *(torch.where(within, row * self.width + column, 0) for row, column in ((y, x), (top, left))), within


def _outside(albedo: Tensor, found: Range, index: Tensor) -> Tensor:
    """Measure how far albedo (3, P) lies outside the range at `index` (…, P), as a mean (…, P) over its components."""
    error = torch.zeros_like(index, dtype=torch.float32)
    for values, low, high in zip(albedo, found.low, found.high, strict=True):
        error += torch.maximum(_take(low, index) - values, values - _take(high, index)).clamp(min=0)
    return error / len(albedo)


def _range(padded: Tensor, side: int) -> Range:
    low, high = (sign * F.max_pool2d(sign * padded, side, 1)[0].flatten(1) for sign in (-1, 1))
    return Range(low, high)


def _take(values: Tensor, index: Tensor) -> Tensor:
    """Fetch values[index] of values (N,), several times faster than by indexing."""
    return values.index_select(0, index.flatten()).view(index.shape)


def _largest(image: Tensor) -> Tensor:
    return F.max_pool2d(image, 3, 1, 1)


def _inside_surfaces(frame: Frame) -> Tensor:
    """Bool mask (1, 1, H, W): the 3×3 pixels around show one surface, as far as instance and depth, or motion, tell."""
    inside: Tensor = frame["albedo"].isfinite().all(1, keepdim=True)
    if "instance" not in frame and "depth" not in frame:
        motion = frame["motion"].nan_to_num()
        low, high = -_largest(-motion), _largest(motion)
        least, share = ONE_MOTION
        longest = torch.maximum(low.abs(), high.abs()).amax(1, keepdim=True)
        inside = inside & ((high - low).amax(1, keepdim=True) <= (share * longest).clamp(min=least))
    if (instance := frame.get("instance")) is not None:
        inside = inside & (_largest(instance) == -_largest(-instance))
    if (depth := frame.get("depth")) is not None:
        inside = inside & (depth > 0) & (_largest(depth) < -ONE_SURFACE * _largest(-depth))
    return inside
