"""Separable joint bilateral filters, steered by noise-free geometry, of fixed or per-pixel size.

Kopf et al. 2007, «Joint Bilateral Upsampling», filtered along x and then along y. What separates two pixels is
the same from both sides, so it is computed once for each pair and frame, and shared by all filters of the frame.
"""

import math
from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor

from nte.motion.neighbours import pairs
from nte.motion.warp import pixel_centres

NORMAL = 64.0  # exponent of normals: e^(64 (n·n′ − 1)), a deviation of 7°
DEPTH = 0.02  # relative deviation of depth from what the surface's slope predicts
ROUGHNESS = 0.1  # deviation of roughness: metal does not mix with the floor it stands on
CLEAN_UP_RADIUS = 4  # 9×9
STRIP = 64  # rows cleaned up at a time
APART = 1e-6  # least weight: what is less alike is another surface, and nothing at all comes across
_SKY = 1e6  # in place of an infinite reciprocal

# Pixels along an axis, and the weights with which the near one gathers the far one and the far one the near one.
Tap = tuple[int, Tensor, Tensor]


class Guide(NamedTuple):
    """What tells surfaces apart, scaled so that weights are e^−(squared differences)."""

    features: Tensor  # (N, 4, H, W) normal and roughness
    disparity: Tensor  # (N, 1, H, W) 1/z, linear in the image on a plane; 0 for the sky
    slope: Tensor  # (N, 2, H, W) its change per pixel along x and y
    tolerance: Tensor  # (N, 1, H, W) z / deviation
    centre: Tensor  # (1, 2, H, W) pixels


class Edges(NamedTuple):
    """How much pixels p and p + k steps along an axis belong together, in (0, 1], for k = 1, 2, …

    along_x[k − 1]: (N, 1, H, W − k), along_y[k − 1]: (N, 1, H − k, W), of the pairs' first pixels.
    """

    along_x: list[Tensor]
    along_y: list[Tensor]

    def rows(self, top: int, bottom: int) -> "Edges":
        """Those within rows top … bottom, as views."""
        along_y = self.along_y[: bottom - top - 1]
        return Edges(
            [weights[:, :, top:bottom] for weights in self.along_x],
            [weights[:, :, top : bottom - k] for k, weights in enumerate(along_y, 1)],
        )


def make_guide(normal: Tensor, depth: Tensor, roughness: Tensor) -> Guide:
    """The guide of normal (N, 3, H, W), depth (N, 1, H, W), 0 = miss, and roughness (N, 1, H, W)."""
    # ‖n − n′‖² = 2 (1 − n·n′): normals and roughness are one distance.
    features = torch.cat([normal * NORMAL**0.5, roughness * (1 / ROUGHNESS)], 1) * 0.5**0.5
    hit = depth > 0
    disparity = torch.where(hit, 1 / depth, 0.0)
    slope = torch.cat([_slope(disparity, axis) for axis in (3, 2)], 1)
    return Guide(features, disparity, slope, torch.where(hit, depth * (0.5**0.5 / DEPTH), _SKY), pixel_centres(depth))


def pair_weight(p: Sequence[Tensor], q: Sequence[Tensor], distance: float = 0) -> tuple[Tensor, Tensor]:
    """The weight of pixels with guides p and q in each other's mean, (N, 1, H, W), twice: `atrous_step`'s edge.

    e^(NORMAL (n·n′ − 1) − ½ (Δroughness / ROUGHNESS)² − ½ (Δz / DEPTH z)²), where Δz is what the mean slope of 1/z
    does not explain: 0 on any plane, however steep.
    """
    here, there = Guide(*p), Guide(*q)
    unexplained = (here.slope + there.slope).mul_(there.centre - here.centre).sum(1, keepdim=True).mul_(0.5)
    unexplained.add_(here.disparity).sub_(there.disparity)
    exponent = unexplained.square_().mul_(here.tolerance).mul_(there.tolerance)
    exponent.add_((here.features - there.features).square_().sum(1, keepdim=True))
    weight = F.threshold(exponent.neg_().exp_(), APART, 0.0, inplace=True)
    return weight, weight


def make_edges(guide: Guide, radius: int) -> Edges:
    """The weights of all pairs up to `radius` apart, or as far as the image goes. Holds 2·radius planes."""

    def along(axis: int) -> list[Tensor]:
        reach = min(radius, guide.disparity.shape[axis] - 1)
        ends = ([pairs(g, axis, k) for g in guide] for k in range(1, reach + 1))
        return [pair_weight([near for near, _ in both], [far for _, far in both])[0] for both in ends]

    return Edges(along(3), along(2))


def joint_bilateral(values: Tensor, edges: Edges, radius: int, deviation: Tensor | float) -> Tensor:
    """Filter (N, C, H, W) with Gaussians times edge weights, (2·radius + 1)², first along x, then along y.

    deviation: of the Gaussian, in pixels; a number or one for each pixel (N, 1, H, W), where 0 is the identity.
    Taps beyond the border do not exist, so a constant stays constant. Costs 4·radius taps.
    """
    for weights, axis in ((edges.along_x, 3), (edges.along_y, 2)):
        values = _gather(values, _gaussian(weights[:radius], axis, deviation), axis)
    return values


def clean_up(values: Tensor, edges: Edges, deviation: Tensor) -> Tensor:
    """The fixed 9×9 filter of Zeng et al. 2021, section 5, with a deviation (N, 1, H, W) for each pixel.

    In strips of rows: beside values and outcome, which may have many channels, there are only a strip's temporaries.
    """
    cleaned, height = torch.empty_like(values), values.shape[2]
    for top in range(0, height, STRIP):
        bottom = min(top + STRIP, height)
        first, last = max(top - CLEAN_UP_RADIUS, 0), min(bottom + CLEAN_UP_RADIUS, height)
        around, widths = (image[:, :, first:last] for image in (values, deviation))
        strip = joint_bilateral(around, edges.rows(first, last), CLEAN_UP_RADIUS, widths)
        cleaned[:, :, top:bottom] = strip[:, :, top - first : bottom - first]
    return cleaned


def _slope(disparity: Tensor, axis: int) -> Tensor:
    """Change of 1/z per pixel along an axis: the smaller of both sides', which is the surface's own at an edge.

    A step between surface and sky says nothing of either's slope; a pixel alone between two has none, 0.
    """
    if disparity.shape[axis] < 2:
        return torch.zeros_like(disparity)
    near, far = pairs(disparity, axis, 1)
    step = torch.where((near > 0) == (far > 0), far - near, float("inf"))
    nothing = torch.full_like(step.narrow(axis, 0, 1), float("inf"))
    ahead, behind = torch.cat([step, nothing], axis), torch.cat([nothing, step], axis)
    smaller = torch.where(ahead.abs() < behind.abs(), ahead, behind)
    return smaller.where(smaller < float("inf"), 0.0)


def _gaussian(weights: Sequence[Tensor], axis: int, deviation: Tensor | float) -> Iterator[Tap]:
    """The taps at 1, 2, … pixels: weights times a Gaussian of the pixel that gathers."""
    if not isinstance(deviation, Tensor):
        for k, weight in enumerate(weights, 1):
            both = weight * math.exp(-0.5 * (k / deviation) ** 2)
            yield k, both, both
        return
    # A deviation of 0 gives an exponent that no float survives, except at the centre.
    ratio = torch.exp(-0.5 / deviation.square().clamp(min=1e-6))
    square = ratio.square()
    gaussian = torch.ones_like(ratio)
    for k, weight in enumerate(weights, 1):
        gaussian.mul_(ratio)  # e^−(k²/2σ²) = e^−((k−1)²/2σ²) · r^(2k−1)
        ratio.mul_(square)
        near, far = pairs(gaussian, axis, k)
        yield k, near * weight, far * weight


def _gather(values: Tensor, taps: Iterable[Tap], axis: int) -> Tensor:
    """The weighted mean of each pixel, weight 1, and of those that `taps` bring to it along an axis."""
    total, norm = values.clone(), torch.ones_like(values[:, :1])
    for k, to_near, to_far in taps:
        near, far = pairs(values, axis, k)
        into_near, into_far = pairs(total, axis, k)
        norm_near, norm_far = pairs(norm, axis, k)
        into_near.addcmul_(to_near, far)
        into_far.addcmul_(to_far, near)
        norm_near.add_(to_near)
        norm_far.add_(to_far)
    return total.div_(norm)
