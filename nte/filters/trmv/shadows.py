"""Shadows: splatted visibility and vectors, and the non-planar heuristic (Zeng et al. 2021, section 4.1)."""

from typing import NamedTuple

import torch
from torch import Tensor
from torch.profiler import record_function

from nte.filters.bilateral import Edges, joint_bilateral
from nte.filters.trmv.scene import RADIUS, Scene, Surface
from nte.filters.trmv.temporal import Effect, Settings, Track, accumulate
from nte.motion.geometric import Reprojection, traditional_motion
from nte.motion.neighbours import pairs
from nte.motion.warp import fetch_nearest, pixel_centres

# px, of the Gaussian in the 31×31 window: half its radius from LINES lines on, and narrower in smaller images, as the
# penumbrae are. At 128 lines 7.5 px would leave nothing of a slat's shadow.
NARROWEST, WIDEST, LINES = 1.5, 7.5, 640
FALLOFF = 0.1  # rad, of G in Eq. 4
_TINY = 1e-30  # not 0: what is divided by it is 0 too


class Splatted(NamedTuple):
    """Filtered visibility, and the vectors of shadows, of all pixels that a shadowed sample reaches."""

    visibility: Tensor  # (N, 1, H, W) in [0, 1]; 1 where no direct light could arrive
    motion: Tensor  # (N, 2, H, W) px, to the previous frame; 0 where no shadow reaches
    shadowed: Tensor  # (N, 1, H, W) bool: some shadowed sample reaches


def denoise_shadows(scene: Scene, track: Track | None, vectors: str, settings: Settings) -> Effect:
    """Visibility (N, 1, H, W) in [0, 1]. vectors: reliable, traditional or none."""
    frame, reliable = scene.frame, vectors == "reliable"
    with record_function("trmv/shadow/filter"):
        splatted = splat(
            frame["visibility"], frame["direct"], frame["shadow_motion"] if reliable else None, scene.edges
        )
    with record_function("trmv/shadow/vectors"):
        reprojection, trust = scene.traditional, None
        if reliable:
            reprojection = shadow_reprojection(splatted, scene.traditional)
            if scene.before is not None:
                trust = planarity(scene.surface, scene.before, scene.traditional, reprojection)
    used = None if vectors == "none" else reprojection
    reach = deviation_for(scene.surface.depth.shape[2])
    return accumulate("shadow", splatted.visibility, track, used, scene, settings, reach, trust)


def splat(visibility: Tensor, direct: Tensor, shadow_motion: Tensor | None, edges: Edges) -> Splatted:
    """Average visibility, and the vectors of shadowed samples, into the centre of each 31×31 footprint.

    visibility (N, 1, H, W) of one shadow ray; direct (N, 3, H, W), 0 where there was nothing to shadow: such a
    pixel says nothing about its neighbours. shadow_motion (N, 2, H, W), NaN where unshadowed; None: no vectors.
    """
    lit = (direct > 0).any(1, keepdim=True).float()
    parts = [lit, lit * visibility]
    if shadow_motion is not None:
        finite = (shadow_motion.abs() < float("inf")).all(1, keepdim=True)
        # 1 − V: the mean of several shadow rays counts each blocked one.
        shadow = lit * (1 - visibility) * finite
        parts += [shadow, shadow * torch.where(finite, shadow_motion, 0.0)]
    reached = joint_bilateral(torch.cat(parts, 1), edges, RADIUS, deviation_for(direct.shape[2]))
    soft = torch.where(lit > 0, reached[:, 1:2] / reached[:, :1].clamp(min=_TINY), 1.0)
    if shadow_motion is None:
        return Splatted(soft, torch.zeros_like(direct[:, :2]), torch.zeros_like(lit, dtype=torch.bool))
    shadowed = reached[:, 2:3] > 0
    motion = torch.where(shadowed, reached[:, 3:] / reached[:, 2:3].clamp(min=_TINY), 0.0)
    return Splatted(soft, motion, shadowed)


def deviation_for(lines: int) -> float:
    """Of the Gaussian, px, for images of so many lines (ours)."""
    return min(max(NARROWEST, WIDEST * lines / LINES), WIDEST)


def shadow_reprojection(splatted: Splatted, traditional: Reprojection) -> Reprojection:
    """Where each pixel's shadow was; fully lit pixels use the traditional vector."""
    motion = torch.where(splatted.shadowed, splatted.motion, traditional.motion)
    return traditional_motion(motion)._replace(disoccluded=traditional.disoccluded)


def planarity(now: Surface, before: Surface, traditional: Reprojection, vectors: Reprojection) -> Tensor:
    """G of Eq. 4, (N, 1, H, W): 1 where the shadow was on the plane of its receiver, falling off beside it.

    θ lies between the normal T⁻¹n(s) and the direction from T⁻¹s to s^V, the surface that was seen at x^V. The
    moved receiver is what was seen at the end of the traditional vector, or, where that was hidden or out
    of the image, the receiver as it is now, which is exact for one at rest.
    """
    here, there = (pixel_centres(now.depth) + v.motion for v in (traditional, vectors))
    then = fetch_nearest(torch.cat([before.position, before.normal, before.depth], 1), here)
    seen = traditional.valid & ~traditional.disoccluded & (then[:, 6:] > 0)
    receiver = torch.where(seen, then[:, :3], now.position)
    normal = torch.where(seen, then[:, 3:6], now.normal)
    landed = fetch_nearest(torch.cat([before.position, before.depth], 1), there)
    away = landed[:, :3] - receiver
    squared = away.square().sum(1, keepdim=True)
    # θ − π/2 = −asin(n·d): the angle by which the direction leaves the plane.
    sine = ((normal * away).sum(1, keepdim=True) * squared.clamp(min=_TINY).rsqrt()).clamp(-1, 1)
    falloff = sine.asin_().mul_(1 / FALLOFF).square_().mul_(-0.5).exp_()
    # Within a pixel's footprint θ has no meaning (ours).
    falloff = torch.where(squared <= squared_footprint(now.position), 1.0, falloff)
    return torch.where(landed[:, 3:] > 0, falloff, 0.0)


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
