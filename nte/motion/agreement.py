"""Variational refinement of a motion field: each pixel's motion is brought into agreement with its neighbours'.

Under noise a single patch gives an unreliable motion, and its neighbours add evidence. The refined motion m minimises

    Σ_p ρ(previous(p + m) − current(p)) + strength · Σ_p,q ψ(|m(p) − m(q)|)

over pixels p and neighbours q. The first sum is taken over windows (Bruhn et al. 2005, «Lucas/Kanade Meets
Horn/Schunck»), and ψ preserves edges of motion. Hanika et al. 2021 name an iterative refinement as future work; this
one is not from their paper.
"""

from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor

from nte.motion.box import box_mean
from nte.motion.neighbours import pairs
from nte.motion.warp import warp

# These values were chosen on training clips.
ROUNDS, STEPS = 2, 4  # linearisations, and Jacobi steps in each
REACH = (2, 6)  # px to the linked neighbours along x and y; distant ones carry motion into flat regions faster
EDGE = 0.05  # px; motions that differ by more belong to different objects
PREFILTER, WINDOW = 3, 5  # px across: the boxes over which images and products are averaged
_TINY = 1e-6
_FARTHEST = 2.0  # px that one linearisation may move the motion; it is not valid farther away


class _Link(NamedTuple):
    """All pairs of pixels that lie `distance` px apart along an axis, and how strongly each pair is coupled."""

    axis: int
    distance: int
    weight: Tensor  # (N, 1, …)


class _System(NamedTuple):
    """Two linear equations per pixel, for x and y: the inverse of the symmetric matrix, and the constant term."""

    xx: Tensor  # (N, 1, H, W)
    xy: Tensor
    yy: Tensor
    constant: Tensor  # (N, 2, H, W)


def agree(current: Tensor, previous: Tensor, motion: Tensor, strength: float, gain: float = 1.0) -> Tensor:
    """Refine the motion (N, 2, H, W), in px, current → previous, of two images (N, C, H, W), and return it.

    strength: weight of the agreement between neighbours. gain: factor for the values; scaled differences above 1 count
    by their absolute value, smaller ones by their square. Needs memory for about twenty planes of the images' size.
    """
    now, before = box_mean(current, PREFILTER), box_mean(previous, PREFILTER)
    for _ in range(ROUNDS):
        motion = _solved(now, warp(before, motion).image, motion, strength, gain)
    return motion


def _solved(now: Tensor, before: Tensor, motion: Tensor, strength: float, gain: float) -> Tensor:
    """The best motion near `motion`; `before` is the previous image fetched along `motion`."""
    links = [_link(motion, axis, k, strength) for axis in (3, 2) for k in REACH if k < motion.shape[axis]]
    system = _system(now, before, motion, links, gain)
    best = motion.clone()
    for _ in range(STEPS):
        right = system.constant.clone()
        for axis, k, weight in links:
            (near, far), (to_near, to_far) = pairs(best, axis, k), pairs(right, axis, k)
            to_near.addcmul_(weight, far)
            to_far.addcmul_(weight, near)
        x, y = right[:, :1], right[:, 1:]
        torch.mul(system.xx, x, out=best[:, :1]).addcmul_(system.xy, y)
        torch.mul(system.yy, y, out=best[:, 1:]).addcmul_(system.xy, x)
        best.sub_(motion).clamp_(-_FARTHEST, _FARTHEST).add_(motion)
    return best


def _link(motion: Tensor, axis: int, distance: int, strength: float) -> _Link:
    """The weights ψ′ of the pairs: greatest for equal motions, falling to 0; all links of a pixel sum to `strength`."""
    one, other = pairs(motion, axis, distance)
    alike = ((one - other).square_().sum(1, keepdim=True) / EDGE**2).add_(1).rsqrt_()
    return _Link(axis, distance, alike.mul_(strength / (4 * len(REACH))))


def _system(now: Tensor, before: Tensor, motion: Tensor, links: list[_Link], gain: float) -> _System:
    """The system (A + Σ links) m' = A m − b + Σ links · neighbours' m', with A and b from `_data`."""
    xx, xy, yy, x, y = _data(now, before, gain)
    u, v = motion[:, :1], motion[:, 1:]
    constant = torch.cat([(xx * u).addcmul_(xy, v).sub_(x), (xy * u).addcmul_(yy, v).sub_(y)], 1)
    for axis, k, pull in links:
        for diagonal in (xx, yy):
            for side in pairs(diagonal, axis, k):
                side.add_(pull)
    scale = 1 / (xx * yy - xy * xy)
    return _System(yy.mul_(scale), xy.mul_(-scale), xx.mul_(scale), constant)


def _data(now: Tensor, before: Tensor, gain: float) -> list[Tensor]:
    """The terms A and b of the windows' equation A (m' − m) = −b, in the order xx, xy, yy, x, y.

    A = Σ w g gᵀ and b = Σ w g d, with differences d = before − now, the mean g of both images' gradients, and w = ρ′.
    The pixels of a window share one increment, not one motion, which preserves edges of motion.
    """
    difference = before - now
    x, y = (_slope(before, axis).add_(_slope(now, axis)).mul_(0.5) for axis in (3, 2))
    weight = gain / (difference.abs() + 1 / gain)
    products = ((x, x), (x, y), (y, y), (x, difference), (y, difference))
    xx, xy, yy, *b = (box_mean((weight * one).mul_(other).sum(1, keepdim=True), WINDOW) for one, other in products)
    # The motion stays where there is neither a gradient nor a neighbour.
    return [xx.add_(_TINY), xy, yy.add_(_TINY), *b]


def _slope(image: Tensor, axis: int) -> Tensor:
    """Central differences of an image along an axis, 0 at the border."""
    if image.shape[axis] < 3:
        return torch.zeros_like(image)
    near, far = pairs(image, axis, 2)
    return F.pad((far - near) / 2, (1, 1, 0, 0) if axis == 3 else (0, 0, 1, 1))
