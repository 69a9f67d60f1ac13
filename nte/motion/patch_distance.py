"""One level of the patch search: the best of 25 shifts, to a fraction of a pixel.

Hanika, Tessari and Dachsbacher 2021, «Fast Temporal Reprojection without Motion Vectors», section 3.1: all pixels are
compared under one shift at a time, and the image of differences is blurred (Darbon et al. 2008).
"""

import math
from typing import Literal

import torch
import torch.nn.functional as F
from torch import Tensor

from nte.motion.box import box_mean
from nte.motion.pyramid import smaller
from nte.motion.warp import fetch_along

Norm = Literal["l2", "l1", "log", "log_centred"]
NORMS = ("l2", "l1", "log", "log_centred")

REACH = 2  # shifts of −2 … 2 px along x and y
_SIDE = 2 * REACH + 1
_SHIFTS = [(x, y) for y in range(-REACH, REACH + 1) for x in range(-REACH, REACH + 1)]  # the 5×5 table, row by row
_CENTRE = len(_SHIFTS) // 2
_WEIGHTS = [2 - math.exp(-0.02 * (x * x + y * y)) for x, y in _SHIFTS]  # of norm log_centred: Equation 5
# Ties: no shift wins, then shorter shifts. Each distance carries its shift's place in this order in its low bits, so
# that one minimum over integers finds distance and shift: 20 times faster than torch.min with indices.
_ORDER = sorted(range(len(_SHIFTS)), key=lambda k: (_SHIFTS[k][0] ** 2 + _SHIFTS[k][1] ** 2, k))
_BITS = 31
_ROUNDING = 8e-6  # relative precision of a distance: two units in the last bit that the order leaves
_PERFECT = 1e-3  # a match below this share of the neighbours' distance is perfect but for the warp's rounding
_PLANE = 1 << 16  # pixels of a strip, whose four working planes fit into a core's cache (1 MB)


def best_shift(current: Tensor, previous: Tensor, radius: int, norm: Norm, refine: bool) -> tuple[Tensor, Tensor]:
    """Find the shift for which current(x) looks most like previous(x + shift), for every pixel.

    Returns the shift (N, 2, H, W), in px, and its patch distance (N, 1, H, W). current and previous: finite images
    (N, C, H, W). Distances are averaged over channels and over (2·radius + 1)² pixels, at the border over the pixels
    that exist; the previous image is clamped at its border. Log distances are returned without log 2 and without the
    weight of the centre, so that 0 means equal. refine: add the minimum of a quadric through the neighbouring
    distances.

    Works in strips and holds the 25 distances of one strip at a time. Costs 50 · log₂(2·radius + 1) additions per
    pixel, or up to twice as many, and 25 logarithms for the log norms.
    """
    count, _, height, width = current.shape
    shift = current.new_empty(count, 2, height, width)
    distance = current.new_empty(count, 1, height, width)
    margin = F.pad(previous, (REACH,) * 4, mode="replicate")
    rows = max(_PLANE // (width + 2 * radius) - 2 * radius, radius, 16)
    work = _Strips(current, radius, rows)
    order = torch.tensor(_ORDER, device=current.device)
    across, down = order % _SIDE - REACH, order.div(_SIDE, rounding_mode="floor") - REACH
    weight = 2 - torch.exp(-0.02 * (across * across + down * down))
    for n in range(count):
        for top in range(0, height, rows):
            bottom = min(top + rows, height)
            table = work.distances(current[n], margin[n], top, bottom, norm)
            best = table.view(torch.int32).amin(0)
            rank = (best & _BITS).flatten()
            least = best.bitwise_and_(~_BITS).view(torch.float32)
            for axis, step in enumerate((across, down)):
                shift[n, axis, top:bottom] = step.index_select(0, rank).view_as(best)
            if norm == "log_centred":  # the weight only chooses the shift; it would pull the fraction towards 0
                least = least / weight.index_select(0, rank).view_as(least)
                table.div_(table.new_tensor(_WEIGHTS).view(-1, 1, 1))
            if refine:
                shift[n, :, top:bottom] += _subpixel(
                    table, order.index_select(0, rank).view_as(best), least, _floor(norm)
                )
            distance[n, 0, top:bottom] = (least - _floor(norm)).clamp(min=0)
    return shift, distance


def distance_along(
    current: Tensor, previous: Tensor, motion: Tensor, norm: Norm, radius: int, shrink: int = 1
) -> Tensor:
    """Compute the patch distance between `current` and `previous` fetched along a motion (N, 2, H, W), px.

    current and previous (N, C, H, W): finite. Log distances are returned without log 2 and without the weight of the
    centre. shrink: the images are compared, and the distance (N, 1, h, w) is returned, smaller by this whole factor.
    """
    difference = smaller(current, shrink) - smaller(fetch_along(previous, motion), shrink)
    distance = difference.square_() if norm == "l2" else difference.abs_()
    distance = distance.mean(1, keepdim=True)
    if norm.startswith("log"):
        distance = torch.log1p(distance / 2)  # log(2 + |a − b|) − log 2
    return box_mean(distance, 2 * radius + 1)


class _Strips:
    """Working memory that is reused for the distances of one strip after another."""

    def __init__(self, like: Tensor, radius: int, rows: int) -> None:
        height, width = like.shape[-2:]
        self.radius, self.height, self.width = radius, height, width
        self.stride = width + 2 * radius
        plane = (rows + 2 * radius) * self.stride
        self.planes = [like.new_zeros(plane) for _ in range(4)]
        self.channel = like.new_empty(rows + 2 * radius, width) if like.shape[1] > 1 else None
        self.table = like.new_empty(len(_SHIFTS) * rows * width)
        self.columns = _existing(width, radius, like)
        self.rows = _existing(height, radius, like)

    def distances(self, current: Tensor, margin: Tensor, top: int, bottom: int, norm: Norm) -> Tensor:
        """Compute the table (25, rows, W) of patch distances for rows top to bottom; the low bits hold each rank."""
        r, size = self.radius, bottom - top
        first, last = max(top - r, 0), min(bottom + r, self.height)
        table = self.table[: len(_SHIFTS) * size * self.width].view(len(_SHIFTS), size, self.width)
        plane = self.planes[0][: (size + 2 * r) * self.stride]
        plane.zero_()  # pixels outside the image add nothing
        pixels = plane.view(-1, self.stride)[first - top + r : last - top + r, r : r + self.width]
        share = 1 / (self.rows[top:bottom, None] * self.columns)
        for place, ((x, y), weight) in enumerate(zip(_SHIFTS, _WEIGHTS, strict=True)):
            shifted = margin[:, first + REACH + y : last + REACH + y, REACH + x : REACH + x + self.width]
            self._differences(current[:, first:last], shifted, pixels, norm)
            sums = self._box(plane).view(-1, self.stride)[:size, : self.width]
            torch.mul(sums, share, out=table[place])
            if norm == "log_centred":
                table[place].mul_(weight)
            table[place].view(torch.int32).bitwise_and_(~_BITS).bitwise_or_(_ORDER.index(place))
        return table

    def _differences(self, current: Tensor, shifted: Tensor, pixels: Tensor, norm: Norm) -> None:
        """Write Equations 2 to 5 per pixel into `pixels`, without the centre's weight.

        Channels are averaged inside the logarithm.
        """
        for c in range(current.shape[0]):
            to = pixels if c == 0 or self.channel is None else self.channel[: pixels.shape[0]]
            torch.sub(current[c], shifted[c], out=to)
            to.square_() if norm == "l2" else to.abs_()
            if c > 0:
                pixels += to
        if current.shape[0] > 1:
            pixels /= current.shape[0]
        if norm in ("log", "log_centred"):
            pixels.add_(2).log_()

    def _box(self, plane: Tensor) -> Tensor:
        """The sums over (2r + 1)² pixels, each at the corner of its box; the margin separates the rows."""
        size, (one, two, three) = 2 * self.radius + 1, (buffer[: plane.shape[0]] for buffer in self.planes[1:])
        across = _sums(plane, size, 1, one, two)
        return _sums(across, size, self.stride, three, one if across is two else two)


def _sums(values: Tensor, count: int, step: int, one: Tensor, two: Tensor) -> Tensor:
    """The sums of `count` elements `step` apart, starting at each element, by doubling; stored in `one` or `two`.

    The last (count − 1) · step elements are undefined. Costs log₂(count) additions, or up to twice as many.
    torch.cumsum, with one addition and one subtraction for any count, takes as long as five additions, and rounds.
    """
    total, taken, elements = values, 1, values.shape[0]
    for bit in bin(count)[3:]:
        for other in (total,) if bit == "0" else (total, values):
            start = taken * step
            taken += taken if other is total else 1
            length = elements - (taken - 1) * step
            torch.add(total[:length], other[start : start + length], out=one[:length])
            total, one, two = one, two, one
    return total


def _existing(size: int, radius: int, like: Tensor) -> Tensor:
    """The number (size,) of the 2·radius + 1 elements around each element that lie inside."""
    at = torch.arange(size, device=like.device)
    return ((at + radius).clamp(max=size - 1) - (at - radius).clamp(min=0) + 1).to(like.dtype)


def _floor(norm: Norm) -> float:
    """The distance of equal patches in this norm."""
    return math.log(2) if norm in ("log", "log_centred") else 0.0


def _subpixel(table: Tensor, place: Tensor, least: Tensor, floor: float) -> Tensor:
    """The fraction (2, rows, W), px, to add to the shift at `place` (rows, W): the minimum of a quadric.

    The quadric is fitted to the 3×3 distances around the shift by least squares with binomial weights (Hasinoff et al.
    2016, supplement, section 1.3). The fraction is 0 where the 3×3 leaves the table, and where the match is perfect:
    patches are not symmetric, so the quadric would move objects at rest.
    """
    x, y = place % _SIDE, place.div(_SIDE, rounding_mode="floor")
    inner = (x > 0) & (x < _SIDE - 1) & (y > 0) & (y < _SIDE - 1)
    at = torch.where(inner, place, _CENTRE).sub_(_SIDE + 1).flatten().mul_(place.numel())  # of the shift up and left
    at += torch.arange(place.numel(), device=place.device)
    planes = table.view(len(_SHIFTS), -1)

    def beside(dx: int, dy: int) -> Tensor:
        return planes[(1 + dx) + _SIDE * (1 + dy) :].take(at).view_as(least).sub_(least)

    nw, n, ne, w, e, sw, s, se = (
        beside(dx, dy) for dx, dy in ((-1, -1), (0, -1), (1, -1), (-1, 0), (1, 0), (-1, 1), (0, 1), (1, 1))
    )
    corners = nw + ne + sw + se
    xx = (w + e - n - s).mul_(2).add_(corners).div_(4)  # the centre itself is 0
    yy = (n + s - w - e).mul_(2).add_(corners).div_(4)
    xy = (nw + se - ne - sw).div_(4)
    to_x = (ne + se - nw - sw).add_((e - w).mul_(2)).div_(8)
    to_y = (sw + se - nw - ne).add_((s - n).mul_(2)).div_(8)
    determinant = xx * yy - xy * xy
    # Where the quadric has no minimum, each axis is solved without the mixed term, if it curves upwards.
    bowl = (xx > 0) & (yy > 0) & (determinant > 0)
    along_x = torch.where(bowl, (xy * to_y - yy * to_x) / determinant, -to_x / xx.clamp(min=1e-30))
    along_y = torch.where(bowl, (xy * to_x - xx * to_y) / determinant, -to_y / yy.clamp(min=1e-30))
    mean = (nw + n + ne + w + e + sw + s + se) / 8
    perfect = least - floor <= _PERFECT * mean + _ROUNDING * floor
    flat = mean <= 2 * _ROUNDING * least  # every shift is equally good or bad
    keep = inner & ~perfect & ~flat
    offset = torch.stack([torch.where(keep & (xx > 0), along_x, 0), torch.where(keep & (yy > 0), along_y, 0)])
    return offset.nan_to_num_(0, 0, 0).clamp_(-1, 1)
