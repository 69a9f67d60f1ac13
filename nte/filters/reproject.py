"""Reprojection with geometric tests: history is fetched tap by tap, and only from pixels that showed the same surface.

Schied et al. 2017, «Spatiotemporal Variance-Guided Filtering», section 4.1, with the constants of NVIDIA's Falcor.
Depth (N, 1, H, W) is along the view axis in scene units, 0 = miss. Normals (N, 3, H, W) are unit, 0 at a miss.
"""

from functools import partial
from itertools import product
from typing import NamedTuple

import torch
from torch import Tensor

from nte.filters.atrous import STRIP_PIXELS
from nte.filters.threads import side_by_side, threads_for
from nte.motion.camera import points_from_depth
from nte.motion.geometric import infinite_sky
from nte.motion.neighbours import own_step
from nte.motion.warp import pixel_centres

# |Δz| / (fwidth(z) + floor · z) ≤ limit. Falcor's floor of 0.01 scene units is this at a depth of 5; with it, surfaces
# that face the same way would share history in scenes of small units, and lose it in scenes of large ones.
DEPTH_FLOOR, DEPTH_LIMIT = 0.002, 10.0
NORMAL_FLOOR, NORMAL_LIMIT = 0.01, 16.0  # ‖Δn‖ / (fwidth(n) + floor) ≤ limit
UNIT = 1e-3  # deviation of a unit vector's length by rounding to half floats, at most
LEAST_WEIGHT = 0.01  # least sum of the bilinear weights that pass; below it, 3×3 pixels are searched


class Geometry(NamedTuple):
    """The values that the tests compare: depth and normal of one frame, and their change from pixel to pixel."""

    depth: Tensor  # (N, 1, H, W), infinite at a miss
    normal: Tensor  # (N, 3, H, W)
    depth_width: Tensor  # fwidth(z), (N, 1, H, W)
    normal_width: Tensor  # ‖fwidth(n)‖, (N, 1, H, W)


class Fetched(NamedTuple):
    """Values (N, C, H, W) of the previous frame, and the mask (N, 1, H, W), bool; values are 0 where it is false."""

    values: Tensor
    valid: Tensor


def geometry_of(depth: Tensor, normal: Tensor) -> Geometry:
    """Make the geometry of a frame; NaN or infinite values count as a miss in depth, and as a normal of 0.

    Normals of other lengths than 1 become unit vectors: those of 8 bits, or averaged over a pixel, are up to some
    percent too short, and a cosine of 0.98² to the power of 128 lets nothing mix.
    """
    far = infinite_sky(depth)  # NaN becomes a miss, since NaN > 0 is false
    normal = torch.where(normal.abs() < float("inf"), normal, 0.0)
    length = normal.square().sum(1, keepdim=True).sqrt_()
    normal = torch.where((length - 1).abs() > UNIT, normal / length.clamp(min=1e-30), normal)
    return Geometry(far, normal, fwidth(far), fwidth(normal).square().sum(1, keepdim=True).sqrt_())


def fwidth(values: Tensor) -> Tensor:
    """Compute |∂/∂x| + |∂/∂y| per pixel of values (N, C, H, W), within the pixel's own surface.

    HLSL's fwidth takes the difference to one side. With `own_step`, a pixel on either side of a silhouette uses a
    neighbour on its own surface, and a thing one pixel wide does not take the step to what is behind it for a slope.
    Where no difference is finite (a single pixel before the sky, an image of one pixel) the width is 0.
    """
    width = torch.zeros_like(values)
    for axis in (2, 3):
        if values.shape[axis] > 1:
            change = values.diff(dim=axis).abs_()
            change = change.where(change < float("inf"), float("inf"))  # also for NaN, the ∞ − ∞ of two misses
            width += own_step(change, axis)
    return width


def previous_depth(depth: Tensor, view: Tensor, projection: Tensor, previous_view: Tensor) -> Tensor:
    """Compute the depth (N, 1, H, W) of the current surface points from the previous camera, as if they had not moved.

    depth (N, 1, H, W): a miss is infinite or 0. view, projection and previous_view (N, 4, 4): for column vectors. When
    a camera moves forward, everything was farther away in the previous frame; a comparison of depths that ignores this
    rejects good history. The form is closed: the depth is A(u, v)·z + B(u, v), with A and B linear in the image
    position.
    """
    # From camera to camera, in double precision: in the world's coordinates, far from its origin, digits would be lost.
    step = (previous_view.double() @ torch.linalg.inv(view.double())).to(view.dtype)
    near, far = (_depth_of_corners(distance, projection, step) for distance in (1.0, 2.0))
    slope, offset = (_linear(corners, depth) for corners in (far - near, 2 * near - far))
    seen = (depth > 0) & (depth < float("inf"))
    return infinite_sky(torch.where(seen, slope * depth + offset, float("inf")))


def _depth_of_corners(distance: float, projection: Tensor, step: Tensor) -> Tensor:
    """The previous depth (N, 1, 2, 2) of points at this depth, at u and v of ¼ and ¾.

    step (N, 4, 4): from the view space of this frame to that of the previous one.
    """
    here = torch.eye(4, device=step.device).expand_as(step)
    points = points_from_depth(torch.full((len(step), 1, 2, 2), distance, device=step.device), here, projection)
    before = torch.einsum("nj,njhw->nhw", step[:, 2, :3], points)[:, None] + step[:, 2, 3].view(-1, 1, 1, 1)
    return points[:, 2:].sign() * before  # cameras look along +z or −z


def _linear(corners: Tensor, like: Tensor) -> Tensor:
    """The linear function (N, 1, H, W) of the pixel position that has the values (N, 1, 2, 2) at u and v of ¼ and ¾."""
    height, width = like.shape[-2:]
    scaled = pixel_centres(like) / like.new_tensor([width, height]).view(1, 2, 1, 1) * 2 - 0.5
    first, right, down = corners[..., :1, :1], corners[..., :1, 1:], corners[..., 1:, :1]
    return first + (right - first) * scaled[:, :1] + (down - first) * scaled[:, 1:]


def reproject(
    values: Tensor,
    motion: Tensor,
    allowed: Tensor,
    now: Geometry,
    before: Geometry,
    expected_depth: Tensor | None = None,
    depth_floor: float = DEPTH_FLOOR,
) -> Fetched:
    """Fetch values(x + motion(x)) from the previous frame, bilinearly over the taps that show the same surface.

    values (N, C, H, W): of the previous frame. motion (N, 2, H, W): px, current → previous, finite. allowed
    (N, 1, H, W), bool: whether there may be history at all. now and before: geometry of both frames.

    A tap passes if it lies inside the image and looks alike, and misses match only misses:

        |Δz| ≤ 10 (fwidth(z) + depth_floor · z)  and  ‖Δn‖ ≤ 16 (fwidth(n) + 0.01)

    Where the bilinear weights of the passing taps sum to less than 0.01, the result is the mean of the passing pixels
    in the 3×3 around the position; where none passes, `valid` is false. expected_depth (N, 1, H, W): from
    `previous_depth`. Objects move too, which that depth does not include, so a tap passes with either the expected or
    the current depth.
    """
    batch, _, height, width = values.shape
    floor = depth_floor * now.depth.where(now.depth < float("inf"), 0.0)
    limits = DEPTH_LIMIT * (now.depth_width + floor), (NORMAL_LIMIT * (now.normal_width + NORMAL_FLOOR)).square()
    here = [now.depth, now.depth if expected_depth is None else expected_depth, now.normal, *limits]
    own = _flat(torch.cat([_finite(t) for t in here], 1))
    taken = _flat(torch.cat([_finite(before.depth), before.normal, values], 1))
    # A position far outside would overflow the integer pixel index. Clamped, it is still outside.
    outermost = motion.new_tensor([width, height]).view(1, 2, 1, 1) + 1
    corner = _flat((pixel_centres(motion) + motion).sub_(0.5).clamp_(min=-2).minimum(outermost))
    start = torch.arange(batch, device=motion.device).mul_(height * width).repeat_interleave(height * width)
    may = _flat(allowed)[0]
    fetched, valid = torch.empty_like(taken[4:]), torch.empty_like(may)

    def fetch(first: int) -> None:
        part = slice(first, first + STRIP_PIXELS)
        taps = _Taps(taken, own[:, part], corner[:, part], start[part], (height, width))
        fetched[:, part], valid[part] = _fetch(taps, may[part])

    side_by_side([partial(fetch, first) for first in range(0, len(may), STRIP_PIXELS)], threads_for(values))
    shape = (-1, batch, height, width)
    return Fetched(fetched.view(shape).transpose(0, 1), valid.view(shape).transpose(0, 1))


class _Taps(NamedTuple):
    """Some pixels, flattened to a row: what they fetch from, what they compare with, and their positions."""

    taken: Tensor  # (4 + C, N·H·W): the previous depth, normal and values
    own: Tensor  # (7, M): depth, expected depth, normal, and the limits of the two tests
    corner: Tensor  # (2, M): position in px, counted from the centre of the first pixel
    start: Tensor  # (M,): index at which the image of the pixel's sequence begins
    size: tuple[int, int]

    def at(self, x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
        """Return the values (C, M) at these whole-numbered positions, and whether each passes the tests: (M,), bool."""
        height, width = self.size
        column, row = x.clamp(0, width - 1), y.clamp(0, height - 1)
        # In integers: float32 has no odd numbers beyond 2²⁴, half of the pixels of an image of 7680×4320.
        index = (row.long() * width).add_(column.long()).add_(self.start)
        there = self.taken.index_select(1, index)
        depth, normal = there[0], there[1:4]
        apart = (depth - self.own[0]).abs_().minimum((depth - self.own[1]).abs_())
        turned = (normal - self.own[2:5]).square_().sum(0)
        return there[4:], (apart <= self.own[5]) & (turned <= self.own[6]) & (column == x) & (row == y)

    def pick(self, chosen: Tensor) -> "_Taps":
        """Return the pixels with these indices."""
        own, corner = (t.index_select(1, chosen) for t in (self.own, self.corner))
        return self._replace(own=own, corner=corner, start=self.start[chosen])


def _fetch(taps: _Taps, may: Tensor) -> tuple[Tensor, Tensor]:
    """The values (C, M) and their validity (M,): bilinear, or searched where too few taps pass."""
    base = taps.corner.floor()
    x, y = taps.corner - base
    total, mean = torch.zeros_like(x), torch.zeros_like(taps.taken[4:, : len(x)])
    for dy, dx in product((0, 1), (0, 1)):
        values, passed = taps.at(base[0] + dx, base[1] + dy)
        weight = (x if dx else 1 - x) * (y if dy else 1 - y) * passed
        total += weight
        mean.addcmul_(values, weight)
    found = (total >= LEAST_WEIGHT) & may
    mean.div_(total.where(found, 1.0)).mul_(found)
    lost = (may & ~found).nonzero()[:, 0]
    if len(lost):
        mean[:, lost], found[lost] = _search(taps.pick(lost))
    return mean, found


def _search(taps: _Taps) -> tuple[Tensor, Tensor]:
    """The mean (C, M) of those of 3×3 pixels that pass, and whether there is any (M,)."""
    x, y = taps.corner.round()
    total, mean = torch.zeros_like(x), torch.zeros_like(taps.taken[4:, : len(x)])
    for dy, dx in product((-1, 0, 1), (-1, 0, 1)):
        values, passed = taps.at(x + dx, y + dy)
        total += passed
        mean.addcmul_(values, passed.to(values.dtype))
    return mean.div_(total.clamp(min=1)), total > 0


def _flat(values: Tensor) -> Tensor:
    """The values (N, C, H, W) as (C, N·H·W): a view for a single image."""
    return values.transpose(0, 1).flatten(1)


def _finite(values: Tensor) -> Tensor:
    """The values with infinite depths as a large finite number, so that the difference of two misses is 0, not NaN."""
    return values.clamp(max=1e30)
