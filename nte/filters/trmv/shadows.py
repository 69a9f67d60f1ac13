"""Shadows: splatted visibility and vectors, and the non-planar heuristic (Zeng et al. 2021, section 4.1)."""

from typing import NamedTuple

import torch
from torch import Tensor
from torch.profiler import record_function

from nte.filters.bilateral import Edges, joint_bilateral
from nte.filters.trmv.accumulation import Effect, History, accumulate
from nte.filters.trmv.inputs import RADIUS, FrameInputs, GBuffer
from nte.filters.trmv.options import TrmvOptions
from nte.filters.trmv.samples import TINY, believable
from nte.frames.usable import mask_of
from nte.motion.geometric import Reprojection, traditional_motion
from nte.motion.neighbours import pairs
from nte.motion.warp import fetch_nearest, pixel_centres

# px, of the Gaussian in the 31×31 window: half its radius from LINES lines on, and narrower in smaller images, as the
# penumbrae are. At 128 lines 7.5 px would leave nothing of a slat's shadow.
NARROWEST, WIDEST, LINES = 1.5, 7.5, 640
FALLOFF = 0.1  # rad, of G in Eq. 4


class Splatted(NamedTuple):
    """Filtered visibility, and the vectors of shadows, of all pixels that a shadowed sample reaches."""

    visibility: Tensor  # (N, 1, H, W) in [0, 1]; 1 where no direct light could arrive
    motion: Tensor  # (N, 2, H, W) px, to the previous frame; 0 where no shadow reaches
    shadowed: Tensor  # (N, 1, H, W) bool: some shadowed sample reaches


def denoise_shadows(
    inputs: FrameInputs, history: History | None, vectors: str, options: TrmvOptions, trust: Tensor | None = None
) -> Effect:
    """Visibility (N, 1, H, W) in [0, 1]. vectors: reliable, traditional or none. trust: of the history, in [0, 1]."""
    frame, reliable = inputs.frame, vectors == "reliable"
    with record_function("trmv/shadow/filter"):
        usable = frame.get(mask_of("visibility"))
        moved = frame["shadow_motion"] if reliable else None
        splatted = splat(frame["visibility"], frame["direct"], moved, inputs.edges, usable)
    with record_function("trmv/shadow/vectors"):
        reprojection = inputs.traditional
        if reliable:
            reprojection = shadow_reprojection(splatted, inputs.traditional)
            if inputs.before is not None:
                trust = planarity(inputs.gbuffer, inputs.before, inputs.traditional, reprojection)
    used = None if vectors == "none" else reprojection
    reach = deviation_for(inputs.gbuffer.depth.shape[2])
    return accumulate("shadow", splatted.visibility, history, used, inputs, options, reach, trust)


def splat(
    visibility: Tensor, direct: Tensor, shadow_motion: Tensor | None, edges: Edges, usable: Tensor | None = None
) -> Splatted:
    """Average visibility, and the vectors of shadowed samples, into the centre of each 31×31 footprint.

    visibility (N, 1, H, W) of one shadow ray; direct (N, 3, H, W), 0 where there was nothing to shadow: such a
    pixel says nothing about its neighbours; nor does one where usable (N, 1, H, W) is 0, which listens to them.
    shadow_motion (N, 2, H, W), NaN where unshadowed; None: no vectors.
    """
    could = (direct > 0).any(1, keepdim=True)
    lit = could.float() if usable is None else could * usable
    parts = [lit, lit * visibility]
    if shadow_motion is not None:
        believed, motion = believable(shadow_motion)
        # 1 − V: the mean of several shadow rays counts each blocked one.
        shadow = lit * (1 - visibility) * believed
        parts += [shadow, shadow * motion]
    reached = joint_bilateral(torch.cat(parts, 1), edges, RADIUS, deviation_for(direct.shape[2]))
    soft = torch.where(could & (reached[:, :1] > TINY), reached[:, 1:2] / reached[:, :1].clamp(min=TINY), 1.0)
    if shadow_motion is None:
        return Splatted(soft, torch.zeros_like(direct[:, :2]), torch.zeros_like(lit, dtype=torch.bool))
    shadowed = reached[:, 2:3] > TINY
    motion = torch.where(shadowed, reached[:, 3:] / reached[:, 2:3].clamp(min=TINY), 0.0)
    return Splatted(soft, motion, shadowed)


def deviation_for(lines: int) -> float:
    """Of the Gaussian, px, for images of so many lines (ours)."""
    return min(max(NARROWEST, WIDEST * lines / LINES), WIDEST)


def shadow_reprojection(splatted: Splatted, traditional: Reprojection) -> Reprojection:
    """Where each pixel's shadow was; fully lit pixels use the traditional vector."""
    motion = torch.where(splatted.shadowed, splatted.motion, traditional.motion)
    return traditional_motion(motion)._replace(disoccluded=traditional.disoccluded)


def planarity(now: GBuffer, before: GBuffer, traditional: Reprojection, vectors: Reprojection) -> Tensor:
    """G of Eq. 4, (N, 1, H, W): 1 where the shadow was on the plane of its receiver, falling off beside it.

    θ lies between the normal T⁻¹n(s) and the direction from T⁻¹s to s^V, the surface that was seen at x^V. The
    moved receiver is what was seen at the end of the traditional vector, or, where that was hidden or out
    of the image, the receiver as it is now, which is exact for one at rest. Normals are geometric ones: a normal
    map would make a flat wall look bent.
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
    # Within a pixel's footprint θ has no meaning (ours).
    falloff = torch.where(squared <= squared_footprint(now.position), 1.0, falloff)
    return torch.where(landed[:, 3:] > 0, falloff, 0.0)


def geometric_normal(gbuffer: GBuffer) -> Tensor:
    """(N, 3, H, W): unit normals without normal maps, of either sign; the shading normal where nothing tells.

    Those that the frame gives, or else across the points of the pixels beside each, on the nearer side along x and
    along y, which is the surface's own at an edge.
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
    """(N, 3, H, W): unit vectors from pixel to pixel along an axis, 0 where no neighbour is a surface."""
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


def squared_footprint(position: Tensor) -> Tensor:
    """(N, 1, H, W): the squared distance in the world to the nearest of the four neighbouring pixels' points."""
    nearest = torch.full_like(position[:, :1], float("inf"))
    for axis in (2, 3):
        if position.shape[axis] > 1:
            near, far = pairs(position, axis, 1)
            step = (far - near).square_().sum(1, keepdim=True)
            for part in pairs(nearest, axis, 1):
                torch.minimum(part, step, out=part)
    return nearest
