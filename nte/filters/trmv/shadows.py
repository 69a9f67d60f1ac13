"""Shadows: splatted visibility and vectors, and the non-planar heuristic (Zeng et al. 2021, section 4.1)."""

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from nte.filters.bilateral import Edges, joint_bilateral
from nte.filters.scope import scope
from nte.filters.trmv.accumulation import Effect, History, accumulate
from nte.filters.trmv.fetch import fetch_within_edges
from nte.filters.trmv.inputs import RADIUS, FrameInputs, GBuffer
from nte.filters.trmv.options import TrmvOptions
from nte.filters.trmv.samples import TINY, believable
from nte.frames.usable import mask_of
from nte.motion.geometric import Reprojection, traditional_motion
from nte.motion.neighbours import pairs
from nte.motion.warp import fetch_nearest, pixel_centres

# Deviation, px, of the Gaussian in the 31×31 window: half its radius in images whose shorter side has LINES pixels or
# more, and less in smaller images, where penumbrae are narrower too. At 128 pixels 7.5 px would erase a slat's shadow.
NARROWEST, WIDEST, LINES = 1.5, 7.5, 640
FALLOFF = 0.1  # rad, of G in Eq. 4


class Splatted(NamedTuple):
    """Filtered visibility, and the vectors of shadows, for all pixels that a shadowed sample reaches."""

    visibility: Tensor  # (N, 1, H, W) in [0, 1]; 1 where no direct light could arrive
    motion: Tensor  # (N, 2, H, W) px, to the previous frame; 0 where no shadow reaches
    shadowed: Tensor  # (N, 1, H, W) bool: some shadowed sample reaches
    known: Tensor  # (N, 1, H, W) bool: there is direct light here, and some usable sample reaches


def denoise_shadows(
    inputs: FrameInputs, history: History | None, vectors: str, options: TrmvOptions, trust: Tensor | None = None
) -> Effect:
    """Denoise visibility (N, 1, H, W) in [0, 1].

    vectors: reliable, traditional or none. trust (N, 1, H, W): of the history, in [0, 1]; with reliable vectors, G of
    Eq. 4 replaces it.
    """
    frame, reliable = inputs.frame, vectors == "reliable"
    with scope("trmv/shadow/filter"):
        usable = frame.get(mask_of("visibility"))
        moved = frame["shadow_motion"] if reliable else None
        splatted = splat(frame["visibility"], frame["direct"], moved, inputs.edges, usable)
    with scope("trmv/shadow/vectors"):
        reprojection, fetcher = inputs.traditional, None
        if reliable:
            reprojection = shadow_reprojection(splatted, inputs.traditional)
            fetcher = fetch_within_edges(reprojection, inputs)
            if inputs.before is not None:
                trust = planarity(inputs.gbuffer, inputs.before, inputs.traditional, reprojection)
    used = None if vectors == "none" else reprojection
    reach = deviation_for(inputs.frame.size)
    visibility, known = splatted.visibility, splatted.known
    return accumulate("shadow", visibility, history, used, inputs, options, reach, trust, fetcher, known)


def splat(
    visibility: Tensor, direct: Tensor, shadow_motion: Tensor | None, edges: Edges, usable: Tensor | None = None
) -> Splatted:
    """Average visibility, and the vectors of shadowed samples, into the centre of each 31×31 footprint.

    visibility (N, 1, H, W): of one or more shadow rays, in [0, 1]. direct (N, 3, H, W): 0 where there was no light to
    shadow; such a pixel contributes nothing to its neighbours. usable (N, 1, H, W): a pixel with 0 contributes nothing
    either, but gets a value from its neighbours. shadow_motion (N, 2, H, W), px: NaN where unshadowed; None: no
    vectors.
    """
    could = (direct > 0).any(1, keepdim=True)
    lit = could.float() if usable is None else could * usable
    parts = [lit, lit * visibility]
    if shadow_motion is not None:
        believed, motion = believable(shadow_motion)
        # Weight 1 − V: in the mean of several shadow rays, each blocked ray counts.
        shadow = lit * (1 - visibility) * believed
        parts += [shadow, shadow * motion]
    reached = joint_bilateral(torch.cat(parts, 1), edges, RADIUS, deviation_for(direct.shape[2:]))
    known = could & (reached[:, :1] > TINY)
    soft = torch.where(known, reached[:, 1:2] / reached[:, :1].clamp(min=TINY), 1.0)
    if shadow_motion is None:
        return Splatted(soft, torch.zeros_like(direct[:, :2]), torch.zeros_like(known), known)
    shadowed = reached[:, 2:3] > TINY
    motion = torch.where(shadowed, reached[:, 3:] / reached[:, 2:3].clamp(min=TINY), 0.0)
    return Splatted(soft, motion, shadowed, known)


def deviation_for(size: Sequence[int]) -> float:
    """Compute the Gaussian's deviation, px, for images of this (height, width), whose shorter side counts.

    This is not in the paper.
    """
    return min(max(NARROWEST, WIDEST * min(size) / LINES), WIDEST)


def shadow_reprojection(splatted: Splatted, traditional: Reprojection) -> Reprojection:
    """Find where each pixel's shadow was; fully lit pixels use the traditional vector."""
    vectors = traditional_motion(splatted.motion)
    return Reprojection(
        torch.where(splatted.shadowed, vectors.motion, traditional.motion),
        torch.where(splatted.shadowed, vectors.valid, traditional.valid),
        traditional.disoccluded,
    )


def planarity(now: GBuffer, before: GBuffer, traditional: Reprojection, vectors: Reprojection) -> Tensor:
    """Compute G of Eq. 4, (N, 1, H, W): 1 where the shadow lay in the plane of its receiver, falling off beside it.

    θ is the angle between the normal T⁻¹n(s) and the direction from T⁻¹s to s^V, the surface that was seen at x^V. The
    moved receiver T⁻¹s is the surface seen at the end of the traditional vector. Where that was hidden or outside the
    image, the current receiver takes its place, which is exact for one at rest. Normals are geometric ones, since a
    normal map would make a flat wall look bent.
    """
    assert now.position is not None
    assert before.position is not None
    here, there = (pixel_centres(now.depth) + v.motion for v in (traditional, vectors))
    then = fetch_nearest(torch.cat([before.position, geometric_normal(before), before.depth], 1), here)
    seen = traditional.valid & ~traditional.disoccluded & (then[:, 6:] > 0)
    receiver = torch.where(seen, then[:, :3], now.position)
    normal = torch.where(seen, then[:, 3:6], geometric_normal(now))
    landed = fetch_nearest(torch.cat([before.position, before.depth], 1), there)
    away = landed[:, :3] - receiver
    squared = away.square().sum(1, keepdim=True)
    # θ − π/2 = −asin(n·d): the angle by which the direction leaves the plane.
    sine = ((normal * away).sum(1, keepdim=True) * squared.clamp(min=TINY).rsqrt()).clamp(-1, 1)
    falloff = sine.asin_().mul_(1 / FALLOFF).square_().mul_(-0.5).exp_()
    # Within a pixel's footprint θ has no meaning (not in the paper).
    falloff = torch.where(squared <= squared_footprint(now.position, now.depth > 0), 1.0, falloff)
    return torch.where(landed[:, 3:] > 0, falloff, 0.0)


def geometric_normal(gbuffer: GBuffer) -> Tensor:
    """Return unit normals (N, 3, H, W) without normal maps, of either sign, or the shading normal where there are none.

    They are the frame's own geometric normals, or else are computed from the points of neighbouring pixels, along x and
    along y on the nearer side, which at an edge is the surface's own.
    """
    if gbuffer.geometric is not None:
        return gbuffer.geometric
    if gbuffer.position is None:
        return gbuffer.normal
    along_x, along_y = (_tangent(gbuffer.position, gbuffer.depth > 0, axis) for axis in (3, 2))
    across = torch.linalg.cross(along_x, along_y, dim=1)
    length = across.norm(dim=1, keepdim=True)
    return torch.where(length > 0, across / length, gbuffer.normal)


def _tangent(position: Tensor, hit: Tensor, axis: int) -> Tensor:
    """Unit vectors (N, 3, H, W) from pixel to pixel along an axis, 0 where no neighbour is a surface."""
    if position.shape[axis] < 2:
        return torch.zeros_like(position)
    near, far = pairs(position, axis, 1)
    one, other = pairs(hit, axis, 1)
    step = far - near
    length = torch.where(one & other, step.norm(dim=1, keepdim=True), float("inf"))
    step, nothing = step / length.clamp(min=TINY), torch.full_like(length.narrow(axis, 0, 1), float("inf"))
    none = torch.zeros_like(step.narrow(axis, 0, 1))
    ahead = torch.cat([length, nothing], axis) < torch.cat([nothing, length], axis)
    return torch.where(ahead, torch.cat([step, none], axis), torch.cat([none, step], axis))


def squared_footprint(position: Tensor, hit: Tensor) -> Tensor:
    """Compute the squared world distance (N, 1, H, W) to the nearest of the four neighbouring pixels' points.

    hit (N, 1, H, W), bool: where there is a point; misses, whose position is 0, are infinitely far.
    """
    nearest = torch.full_like(position[:, :1], float("inf"))
    for axis in (2, 3):
        if position.shape[axis] > 1:
            near, far = pairs(position, axis, 1)
            one, other = pairs(hit, axis, 1)
            step = torch.where(one & other, (far - near).square_().sum(1, keepdim=True), float("inf"))
            for part in pairs(nearest, axis, 1):
                torch.minimum(part, step, out=part)
    return nearest
