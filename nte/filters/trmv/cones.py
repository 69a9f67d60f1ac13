"""Incident radiance in six cones over each pixel's hemisphere (Zeng et al. 2021, sections 4.3 and 5).

One cone lies along the normal and five at 60° to it, in world space, so that pixels with other normals can use them. A
pixel's cones are (N, 24, H, W): for each cone its weight times radiance (RGB), then its weight. Sums of these are
weighted means. An empty cone has weight 0: its radiance is unknown, not black.
"""

import functools
import math

import torch
import torch.nn.functional as F
from torch import Tensor

CONES = 6
HALF_ANGLE = math.acos(5 / 6)  # solid angle π/3 sr; the half-angle π/6 of the paper's text has 0.84 sr and leaves gaps
KNOWN = 1e-6  # least weight that counts
PARALLEL = 1 - 1e-6  # n·n′ from which normals count as equal: 0.08°; rounding to half floats turns them by 0.03°
_TILT = math.pi / 3
_DISTINCT = 1e-3  # rad, least chord of circles that intersect: cones of 30° only touch
# Each sample goes to the cone with the nearest axis, which divides the hemisphere into cells. WEIGHTS are the
# cosine-weighted solid angles of these cells, sr: with them light from any direction keeps its energy, and since they
# sum to π, a white environment is exactly white. For the cell around the normal, Lambert's formula for a polygon gives
# ½ Σ Θ cos(60°) over its five edges of length Θ.
_CORNER = math.atan(math.tan(_TILT / 2) / math.cos(math.pi / 5))  # from the axis to a corner of its cell
_EDGE = math.acos(math.cos(_CORNER) ** 2 + math.sin(_CORNER) ** 2 * math.cos(2 * math.pi / 5))
WEIGHTS = (5 / 4 * _EDGE, *(5 * [(math.pi - 5 / 4 * _EDGE) / 5]))
EQ_11 = CONES * (math.pi / 3,)  # the paper's weights, without a cosine, so that a white environment becomes 2, not 1
# The frame at a normal is that of _POLE, turned the shortest way. It is discontinuous only at −_POLE, which is not an
# axis of the world, so that all pixels of a wall or floor have the same frame.
_POLE = (0.4082, 0.7071, 0.5774)


def local_axes() -> Tensor:
    """Compute the axes (6, 3), float64, of the cones at the normal _POLE."""
    pole = F.normalize(torch.tensor(_POLE, dtype=torch.float64), dim=0)
    across = torch.linalg.cross(pole, torch.tensor([1.0, 0, 0], dtype=torch.float64))
    across = across / across.norm()
    up = torch.linalg.cross(pole, across)
    turns = torch.arange(5, dtype=torch.float64)[:, None] * (2 * math.pi / 5)
    ring = math.cos(_TILT) * pole + math.sin(_TILT) * (turns.cos() * across + turns.sin() * up)
    return torch.cat([pole[None], ring])


def cone_axes(normal: Tensor) -> Tensor:
    """Compute the world axes (P, 6, 3) of the cones at unit normals (P, 3)."""
    local = local_axes().to(normal)
    pole = local[0]
    middle = pole + normal
    # The rotation of a vector v that takes the pole to n: v − (m·v / (½ m·m)) m + 2 (pole·v) n, with m = pole + n.
    along = torch.einsum("pi,ki->pk", middle, local) / _half_square(middle)
    return local - along[..., None] * middle[:, None] + 2 * (local @ pole)[:, None] * normal[:, None]


def _half_square(middle: Tensor) -> Tensor:
    """½ m·m (P, 1, …) of m = pole + n (P, 3, …); it equals 1 + pole·n without that sum's rounding near −_POLE."""
    return middle.square().sum(1, keepdim=True).mul_(0.5).clamp_(min=torch.finfo(middle.dtype).tiny)


def overlap(cosine: Tensor, half_angle: float) -> Tensor:
    """Compute the solid angle Ω, sr, that two cones of this half-angle share: Eqs. 9 and 10 (Mazonka).

    cosine: of the angle between the cones' axes, of any shape. half_angle: radians.
    """
    # The paper's arctan for γ simplifies to half the angle between the axes.
    sine, rest = ((1 - cosine) / 2).clamp(0, 1).sqrt(), ((1 + cosine) / 2).clamp(1e-12, 1).sqrt()
    beta = (sine / math.sin(half_angle)).clamp(max=1).acos()
    phi = (sine / rest / math.tan(half_angle)).clamp(max=1).acos()
    return 4 * (beta - phi * math.cos(half_angle))


def moved_shares(normal: Tensor, other: Tensor, half_angle: float) -> Tensor:
    """Compute the shares (P, 6, 6), in [0, 1], of the samples in cone j at `other` (P, 3) that cone k at `normal` gets.

    The shares of j are of all samples above the horizon, in proportion to Ω_kj less the overlap of cones k and j of one
    hemisphere, so that nothing moves unless normals turn. That subtraction is not in the paper: the overlap itself,
    applied in every frame, would diffuse directions.
    """
    axes = cone_axes(other)
    cosine = torch.einsum("pki,pji->pkj", cone_axes(normal), axes)
    at_rest, scale = (table.to(cosine) for table in _at_rest(half_angle))
    shares = overlap(cosine, half_angle).sub_(at_rest).clamp_(min=0).mul_(scale)
    # The axes of the ring are 30° above the horizon, and its samples lie within 30° of them, most of them higher. So no
    # sample is below the horizon, and all are once the axis has turned to 30° below it.
    height = torch.einsum("pji,pi->pj", axes, normal).clamp_(-1, 1).asin_()
    above = 1 - (((math.pi / 6 - height) / _TILT).clamp_(0, 1)).square_()
    return shares.mul_((above / shares.sum(1).clamp_(min=KNOWN)).unsqueeze(1))


@functools.cache
def _at_rest(half_angle: float) -> tuple[Tensor, Tensor]:
    """Two tables (6, 6): Ω between the cones of one hemisphere, and factors from changes of Ω to shares of samples.

    The factor is 1 / Ω(0) between a cone and its own place. Neighbouring cells share a whole edge and exchange more
    samples than the cones do: for a small turn straight across the edge, the samples that pass are the integral of cos
    θ along the edge, while Ω grows by the chord that the two circles have in common.
    """
    axes = local_axes()
    cosine = axes @ axes.T
    shared = overlap(cosine, half_angle).fill_diagonal_(0)
    chord = 2 * (math.sin(half_angle) ** 2 - (1 - cosine) / 2).clamp(min=0).sqrt().fill_diagonal_(0)
    middle = (_CORNER + math.pi / 2) / 2  # of the edge between two cones of the ring: from a corner to the horizon
    beside = (math.cos(middle) * (math.pi / 2 - _CORNER) + math.sin(math.pi / 2 - _CORNER) * math.sin(_CORNER)) / 2
    passing = torch.full_like(cosine, beside)
    passing[0] = passing[:, 0] = math.cos(_TILT / 2) * (_EDGE + math.sin(_EDGE)) / 2
    scale = torch.full_like(cosine, 1 / (2 * math.pi * (1 - math.cos(half_angle))))
    passing /= axes.new_tensor(WEIGHTS)
    return shared, torch.where(chord > _DISTINCT, passing / chord.clamp(min=_DISTINCT), scale)


def sample_to_cones(radiance: Tensor, direction: Tensor, normal: Tensor) -> Tensor:
    """Sort one sample per pixel into the cone with the nearest axis, and return the cones (N, 24, H, W).

    radiance (N, 3, H, W) arrives from direction (N, 3, H, W), a world vector that points away from the surface; a zero
    direction marks a pixel without a sample. normal (N, 3, H, W): unit.
    """
    local = local_axes().to(normal)
    pole = local[0].view(1, 3, 1, 1)
    middle = pole + normal
    # The direction in the frame of the pole, by the inverse of the rotation in `cone_axes`.
    along = (middle * direction).sum(1, keepdim=True) / _half_square(middle)
    turned = direction - along * middle + 2 * (normal * direction).sum(1, keepdim=True) * pole
    parts = [turned[:, i : i + 1] for i in range(3)]
    best = torch.full_like(parts[0], -math.inf)
    nearest = torch.zeros_like(best, dtype=torch.int64)
    for k, axis in enumerate(local.tolist()):  # one by one, since argmax over so few takes four times as long
        cosine = sum(part * a for part, a in zip(parts, axis, strict=True))
        nearest.masked_fill_(cosine > best, k)
        torch.maximum(best, cosine, out=best)
    taken = (direction != 0).any(1, keepdim=True)
    sample = torch.cat([radiance, torch.ones_like(radiance[:, :1])], 1) * taken
    cones = torch.zeros_like(sample[:, None]).repeat(1, CONES, 1, 1, 1)
    return cones.scatter_(1, nearest[:, None].expand_as(sample[:, None]), sample[:, None]).flatten(1, 2)


def known(cones: Tensor) -> Tensor:
    """Return (N, 1, H, W) bool: whether any sample fell into a pixel's cones (N, 24, H, W)."""
    return split(cones)[1].sum(1) > KNOWN


def mean_radiance(cones: Tensor) -> Tensor:
    """Compute the mean (N, 3, H, W) of a pixel's samples from all directions, 0 where there are none."""
    sums = by_cone(cones, 4).sum(1)
    return torch.where(sums[:, 3:] > KNOWN, sums[:, :3] / sums[:, 3:].clamp(min=KNOWN), 0.0)


def cone_radiance(cones: Tensor, k: int, mean: Tensor) -> Tensor:
    """Compute the radiance (N, 3, H, W) in cone k, or `mean` where it is unknown."""
    premultiplied, weight = cones[:, 4 * k : 4 * k + 3], cones[:, 4 * k + 3 : 4 * k + 4]
    return torch.where(weight > KNOWN, premultiplied / weight.clamp(min=KNOWN), mean)


def split(cones: Tensor) -> tuple[Tensor, Tensor]:
    """Return views of weight times radiance, (N, 6, 3, H, W), and of the weights, (N, 6, 1, H, W)."""
    apart = by_cone(cones, 4)
    return apart[:, :, :3], apart[:, :, 3:]


def by_cone(values: Tensor, channels: int) -> Tensor:
    """Return a view (N, 6, channels, …) of values (N, 6·channels, …)."""
    return values.view(values.shape[0], CONES, channels, *values.shape[2:])


def irradiance(cones: Tensor, weights: tuple[float, ...] = WEIGHTS) -> Tensor:
    """Compute Σ w_k L_k / π, (N, 3, H, W), from cones (N, 24, H, W) with radiance L_k.

    weights w_k: of the cones, sr. Multiplied by the albedo, the result is the reflected radiance.
    """
    mean = mean_radiance(cones)
    total = torch.zeros_like(mean)
    for k, weight in enumerate(weights):
        total.add_(cone_radiance(cones, k, mean), alpha=weight / math.pi)
    return total


def transfer(cones: Tensor, normal: Tensor, to: Tensor, half_angle: float) -> Tensor:
    """Convert cones (N, 24, H, W) at `normal` (N, 3, H, W) to cones at the normals `to`, in place, and return them.

    Samples go where their directions lie: into another cone, or away if below the horizon. A cone that gets none is
    unknown. Where normals are parallel, as in most of an image, nothing moves.
    """
    turned = ((normal * to).sum(1) < PARALLEL) & (split(cones)[1].sum(1)[:, 0] > 0)
    n, y, x = turned.nonzero(as_tuple=True)
    if len(n):
        shares = moved_shares(to[n, :, y, x], normal[n, :, y, x], half_angle)
        moved = torch.einsum("pkj,pjc->pkc", shares, by_cone(cones[n, :, y, x], 4))
        cones[n, :, y, x] = moved.flatten(1)
    return cones
