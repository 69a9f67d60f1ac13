"""Separable joint bilateral filters, guided by noise-free geometry, of fixed or per-pixel size.

Kopf et al. 2007, «Joint Bilateral Upsampling», applied along x and then along y. The edge weight of two pixels is the
same from both sides, so it is computed once per pair and frame, and shared by all filters of the frame.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor

from nte.filters.threads import side_by_side, threads_for
from nte.motion.neighbours import own_step, pairs

NORMAL = 64.0  # exponent of normals: e^(64 (n·n′ − 1)), a deviation of 7°
DEPTH = 0.02  # relative deviation of depth from what the surface's slope predicts
ROUGHNESS = 0.1  # deviation of roughness: metal does not mix with the floor it stands on
CLEAN_UP_RADIUS = 4  # px: a window of 9×9
STRIP_VALUES = 1 << 17  # values filtered together: half a megabyte, and as much again, fit into a core's cache
CHANNELS = 4  # channels filtered at a time
LINE = 32  # least number of columns of a strip, since memory is read in lines
APART = 1e-6  # least weight: pixels that are less alike show different surfaces, which do not mix at all
NEGLIGIBLE = (-2 * math.log(APART)) ** 0.5  # deviations at which a Gaussian falls to APART
_SKY = 1e6  # stands for an infinite reciprocal

# A distance k in pixels along an axis, and two weights: of the far pixel in the near one's mean, and the reverse.
Tap = tuple[int, Tensor, Tensor]


class Guide(NamedTuple):
    """The features that tell surfaces apart, scaled so that weights are e^−(squared differences)."""

    features: Tensor  # (N, 4, H, W) normal and roughness
    disparity: Tensor  # (N, 1, H, W) 1/z, linear in the image on a plane; 0 for the sky
    slope: Tensor  # (N, 2, H, W) change of the disparity per pixel along x and y
    tolerance: Tensor  # (N, 1, H, W) z / deviation


class Strip(NamedTuple):
    """A range of rows (dim 2) or columns (dim 3); calling it cuts them out of a tensor (N, C, H, W), as a view."""

    dim: int
    first: int
    length: int

    def __call__(self, tensor: Tensor) -> Tensor:
        return tensor.narrow(self.dim, self.first, self.length)


class Edges(NamedTuple):
    """Edge weights in [0, 1] of pixels p and p + k steps along an axis, for k = 1, 2 and so on.

    along_x[k − 1] is (N, 1, H, W − k) and along_y[k − 1] is (N, 1, H − k, W), stored at the pairs' first pixels.
    """

    along_x: list[Tensor]
    along_y: list[Tensor]


def make_guide(normal: Tensor, depth: Tensor, roughness: Tensor) -> Guide:
    """Make the guide from normal (N, 3, H, W), depth (N, 1, H, W), 0 = miss, and roughness (N, 1, H, W)."""
    # ‖n − n′‖² = 2 (1 − n·n′), so normals and roughness enter one squared distance.
    features = torch.cat([normal * NORMAL**0.5, roughness * (1 / ROUGHNESS)], 1) * 0.5**0.5
    hit = depth > 0
    disparity = torch.where(hit, 1 / depth, 0.0)
    slope = torch.cat([_slope(disparity, axis) for axis in (3, 2)], 1)
    return Guide(features, disparity, slope, torch.where(hit, depth * (0.5**0.5 / DEPTH), _SKY))


def pair_weight(guide: Guide, axis: int, k: int) -> Tensor:
    """Compute the edge weight of all pairs of pixels k steps apart along an axis, (N, 1, H, W − k) or (N, 1, H − k, W).

    The weight is e^(NORMAL (n·n′ − 1) − ½ (Δroughness / ROUGHNESS)² − ½ (Δz / DEPTH z)²), and 0 below APART. Δz is the
    part of the depth difference that the mean slope of 1/z does not explain: 0 on any plane, however steep. Symmetric.
    """
    here, there = (Guide(*ends) for ends in zip(*(pairs(part, axis, k) for part in guide), strict=True))
    along = slice(3 - axis, 4 - axis)
    unexplained = (here.slope[:, along] + there.slope[:, along]).mul_(0.5 * k)
    unexplained.add_(here.disparity).sub_(there.disparity)
    exponent = unexplained.square_().mul_(here.tolerance).mul_(there.tolerance)
    for one, other in zip(here.features.unbind(1), there.features.unbind(1), strict=True):
        apart = (one - other).unsqueeze(1)  # one by one, since a sum over so few channels is slow
        exponent.addcmul_(apart, apart)
    return F.threshold(exponent.neg_().exp_(), APART, 0.0, inplace=True)


def make_edges(guide: Guide, radius: int) -> Edges:
    """Compute the weights of all pairs up to `radius` px apart, or as far as the image goes; holds 2·radius planes."""

    def along(axis: int) -> list[Tensor]:
        ks = range(1, min(radius, guide.disparity.shape[axis] - 1) + 1)
        planes = [pairs(guide.disparity, axis, k)[0].clone(memory_format=torch.contiguous_format) for k in ks]

        def fill(strip: Strip) -> None:
            part = Guide(*(strip(g) for g in guide))
            for k, plane in zip(ks, planes, strict=True):
                strip(plane).copy_(pair_weight(part, axis, k))

        in_strips(fill, guide.features, axis)
        return planes

    return Edges(along(3), along(2))


def joint_bilateral(
    values: Tensor, edges: Edges, radius: int, deviation: Tensor | float, in_place: bool = False
) -> Tensor:
    """Filter values (N, C, H, W) with a Gaussian times edge weights over (2·radius + 1)², along x and then along y.

    edges: weights of pairs, at least up to `radius` px. deviation: of the Gaussian, in px; a number, or one for each
    pixel (N, 1, H, W), where 0 is the identity. Taps more than NEGLIGIBLE deviations away are left out, and taps beyond
    the border do not exist, so a constant stays constant. in_place: write the result into the memory of the values.
    Costs 4·radius taps, or fewer where the widest deviation of a strip is small.
    """

    def taps(weights: Sequence[Tensor], axis: int, width: Tensor | float) -> list[list[Tap]]:
        widest = float(width.max()) if isinstance(width, Tensor) else width
        reach = min(radius, math.ceil(NEGLIGIBLE * widest))
        return [list(_gaussian(weights[:reach], axis, width))]

    return _along_both(values, edges, deviation, taps, in_place)


def atrous_bilateral(values: Tensor, edges: Edges, levels: int, in_place: bool = False) -> Tensor:
    """Filter values (N, C, H, W) by à-trous levels of 3 taps, 1, 2, 4, … px apart, along x and then along y.

    4 levels reach 31×31 pixels with 16 taps besides the centre. edges: weights of pairs, up to 2^(levels − 1) px. A
    constant stays constant. in_place: write the result into the memory of the values.
    """

    def taps(weights: Sequence[Tensor], axis: int, width: Tensor | float) -> list[list[Tap]]:
        steps = [k for k in (2**level for level in range(levels)) if k <= len(weights)]
        halves = [weights[k - 1] * 0.5 for k in steps]
        return [[(k, half, half)] for k, half in zip(steps, halves, strict=True)]

    return _along_both(values, edges, 0.0, taps, in_place)


def clean_up(values: Tensor, edges: Edges, deviation: Tensor, in_place: bool = False) -> Tensor:
    """Apply the fixed 9×9 filter of Zeng et al. 2021, section 5, with a deviation (N, 1, H, W), px, for each pixel."""
    return joint_bilateral(values, edges, CLEAN_UP_RADIUS, deviation, in_place)


def in_strips(work: Callable[[Strip], None], like: Tensor, axis: int) -> None:
    """Run `work` on each strip along `axis` of an image (N, C, H, W): on some rows for axis 3, some columns for axis 2.

    A filter along the axis needs nothing from outside its strip. Strips are so small that a few channels of one fit
    into a core's cache.
    """
    across = 5 - axis
    length, whole = like.shape[across], like.shape[across]
    if like.device.type == "cpu":
        length = max(STRIP_VALUES // (like.shape[0] * CHANNELS * like.shape[axis]), 1 if axis == 3 else LINE)
    strips = [Strip(across, first, min(length, whole - first)) for first in range(0, whole, length)]
    side_by_side([partial(work, strip) for strip in strips], threads_for(like))


def _along_both(
    values: Tensor,
    edges: Edges,
    deviation: Tensor | float,
    taps: Callable[[Sequence[Tensor], int, Tensor | float], list[list[Tap]]],
    in_place: bool,
) -> Tensor:
    """The values after the passes of `taps`, along x and then along y; `taps` gets weights, axis and deviation."""
    filtered, source = values if in_place else torch.empty_like(values), values
    for weights, axis in ((edges.along_x, 3), (edges.along_y, 2)):

        def one(strip: Strip, weights: Sequence[Tensor] = weights, axis: int = axis, source: Tensor = source) -> None:
            width = strip(deviation) if isinstance(deviation, Tensor) else deviation
            passes = [(of, _share(strip(source), of, axis)) for of in taps([strip(w) for w in weights], axis, width)]
            for first in range(0, values.shape[1], CHANNELS):
                part, out = (strip(image)[:, first : first + CHANNELS] for image in (source, filtered))
                for of, share in passes:
                    part = _gather(part, of, share, axis)
                out.copy_(part)

        in_strips(one, values, axis)
        source = filtered
    return filtered


def _slope(disparity: Tensor, axis: int) -> Tensor:
    """The change of 1/z per pixel along an axis, within each pixel's own surface.

    A step between surface and sky gives no slope for either; a pixel between two such steps has the slope 0.
    """
    if disparity.shape[axis] < 2:
        return torch.zeros_like(disparity)
    near, far = pairs(disparity, axis, 1)
    return own_step(torch.where((near > 0) == (far > 0), far - near, float("inf")), axis)


def _gaussian(weights: Sequence[Tensor], axis: int, deviation: Tensor | float) -> Iterator[Tap]:
    """The taps at 1, 2, … px: edge weights times a Gaussian with the deviation of the pixel that gathers."""
    if not isinstance(deviation, Tensor):
        for k, weight in enumerate(weights, 1):
            both = weight * math.exp(-0.5 * (k / deviation) ** 2)
            yield k, both, both
        return
    # A deviation of 0 gives so large an exponent that every weight but the centre's becomes 0.
    ratio = torch.exp(-0.5 / deviation.square().clamp(min=1e-6))
    square = ratio.square()
    gaussian = torch.ones_like(ratio)
    for k, weight in enumerate(weights, 1):
        # e^−(k²/2σ²) = e^−((k−1)²/2σ²) · r^(2k−1); small factors become 0, since denormal numbers are slow.
        F.threshold(gaussian.mul_(F.threshold(ratio, APART, 0.0, inplace=True)), APART, 0.0, inplace=True)
        ratio.mul_(square)
        near, far = pairs(gaussian, axis, k)
        yield k, near * weight, far * weight


def _share(values: Tensor, taps: Iterable[Tap], axis: int) -> Tensor:
    """The inverse (N, 1, H, W) of the sum of each pixel's own weight, 1, and the weights of its taps."""
    norm = torch.ones_like(values[:, :1], memory_format=torch.contiguous_format)
    for k, to_near, to_far in taps:
        near, far = pairs(norm, axis, k)
        near.add_(to_near)
        far.add_(to_far)
    return norm.reciprocal_()


def _gather(values: Tensor, taps: Iterable[Tap], share: Tensor, axis: int) -> Tensor:
    """The weighted mean of each pixel, with weight 1, and of the pixels that its taps reach along an axis."""
    total = values.clone(memory_format=torch.contiguous_format)
    for k, to_near, to_far in taps:
        near, far = pairs(values, axis, k)
        into_near, into_far = pairs(total, axis, k)
        into_near.addcmul_(to_near, far)
        into_far.addcmul_(to_far, near)
    return total.mul_(share)
