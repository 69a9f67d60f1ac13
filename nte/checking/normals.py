"""A check that normals are perpendicular to the surface that neighbouring positions span.

If they are not, and a single rotation of all normals makes them so, they are given in another space, such as that of
the camera. If only the signs of some walls' normals are wrong, half a turn explains that as well: it tells nothing.
If nothing explains them, they are those of other surfaces, or bent on purpose, as on the leaves of trees.
"""

import math
from collections.abc import Iterator, Sequence
from statistics import median
from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor

from nte.checking.textures import ONE_SURFACE
from nte.checking.values import Finding
from nte.motion.warp import pixel_centres

ENOUGH = 200  # least number of surface points that can tell
SAMPLED = 4096  # points of a frame that are looked at, up to twice as many
OFF = 0.005  # 1 − cosine to the surface's own normal, on average, from which on normals do not agree with it: 6°
TURNED = 0.3  # a rotation explains the normals if it leaves at most this share of that
ALONG = 0.95  # cosine, up to its sign, of normals that agree with the surface
APART = 0.9  # least mean cosine, up to its sign, of normals that belong to the surfaces; measured: 0.99
SOME = 0.05  # share of the pixels whose normals point away from which on it is told
ALL = 0.95  # from this share on they are negated, or every surface is seen from behind, which a few walls may be
EVEN = 0.1  # two steps between neighbours of one surface differ by less than this share of both together


class Turn(NamedTuple):
    """Mean cosines of normals to the surface: as they are, up to their sign, and after the best rotation."""

    given: float
    unsigned: float
    turned: float
    rounded: float = 0.0  # what rounding of positions may take from them


def turn_of(
    normal: Tensor, position: Tensor, hit: Tensor, depth: Tensor | None, spanning: Tensor | None, steps: Tensor
) -> Turn | None:
    """Compare normals (3, H, W) with the surface that the positions (3, H, W) of neighbours span.

    hit: bool (H, W), pixels with a position. depth (H, W) tells which neighbours show one surface; without it those do
    whose positions are evenly spaced. spanning: bool (H, W), pixels whose positions span the space, and so tell with
    depth which side of a surface is seen; None: normals count as facing the camera. steps: (H, W), to which positions
    are rounded. None if too few pixels can tell.
    """
    if min(hit.shape) < 3:
        return None
    across, down = position[:, 1:-1, 2:] - position[:, 1:-1, :-2], position[:, 2:, 1:-1] - position[:, :-2, 1:-1]
    surface = torch.linalg.cross(across, down, dim=0)
    normal = normal[:, 1:-1, 1:-1]
    inside = hit.unfold(0, 3, 1).unfold(1, 3, 1).flatten(2).all(2)
    if depth is not None:
        around = depth.unfold(0, 3, 1).unfold(1, 3, 1).flatten(2)
        inside = inside & (around.amax(2) < ONE_SURFACE * around.amin(2))
    else:
        bends = position.diff(n=2, dim=2)[:, 1:-1], position.diff(n=2, dim=1)[:, :, 1:-1]
        for bend, both in zip(bends, (across, down), strict=True):
            inside = inside & (bend.norm(dim=0) < EVEN * both.norm(dim=0))
    inside = inside & surface.isfinite().all(0) & (surface.norm(dim=0) > 0)
    inside = inside & normal.isfinite().all(0) & (normal.norm(dim=0) > 0.5) & _smooth(surface)
    if int(inside.sum()) < ENOUGH:
        return None
    step = max(1, int(inside.sum()) // SAMPLED)
    # About a quarter of a step at both ends of each side; a right angle at most.
    angles = [(steps[1:-1, 1:-1] / 2 / side.norm(dim=0))[inside][::step] for side in (across, down)]
    rounded = 1 - (angles[0].square() + angles[1].square()).sqrt().clamp(max=math.pi / 2).cos()
    surface, normal = (values[:, inside][:, ::step] for values in (surface, normal))
    surface, normal = surface / surface.norm(dim=0), normal / normal.norm(dim=0)
    if depth is None or spanning is None:
        away = float(-(surface * normal).sum(0).median())
    else:
        away = _side(position, spanning, depth)
    surface = -surface if away > 0 else surface
    cosine, turned = (surface * normal).sum(0), _turned(surface, normal)
    # Bumps are in no surface, however normals are turned: where they are strong, the rest of the pixels tells.
    smooth = (cosine.abs() > ALONG) | (turned.abs() > ALONG)
    if 2 * int(smooth.sum()) > len(smooth) and int(smooth.sum()) >= ENOUGH:
        cosine, turned, rounded = cosine[smooth], _turned(surface[:, smooth], normal[:, smooth]), rounded[smooth]
    return Turn(float(cosine.mean()), float(cosine.abs().mean()), float(turned.mean()), float(rounded.mean()))


def _side(position: Tensor, hit: Tensor, depth: Tensor) -> float:
    """Tell which way cross products point, of steps to the right and down: above 0 if away from the camera.

    They do if (x z, y z, z), of what is seen at (x, y) with depth z, is a linear function of position that keeps the
    handedness. The view axis does not tell: a level camera sees the floor and the ceiling along it.
    """
    seen = torch.cat([pixel_centres(depth[None, None])[0] / max(hit.shape), torch.ones_like(depth)[None]]) * depth
    step = max(1, int(hit.sum()) // SAMPLED)
    points, seen = (values[:, hit][:, ::step] for values in (position, seen))
    points, seen = (values - values.mean(1, keepdim=True) for values in (points, seen))
    return float(torch.linalg.lstsq(points.T / points.std(), seen.T / seen.std()).solution.det())


def _smooth(surface: Tensor) -> Tensor:
    """Mark the points (H, W) whose direction (3, H, W) is that of a neighbour, unlike those of grass."""
    unit = F.pad(surface / surface.norm(dim=0).clamp(min=1e-30), (0, 1, 0, 1))
    beside = [(unit[:, :-1, :-1] * other).sum(0).abs() for other in (unit[:, :-1, 1:], unit[:, 1:, :-1])]
    return torch.maximum(*beside) > ALONG


def _turned(surface: Tensor, normal: Tensor) -> Tensor:
    """Cosines (n,) between the surface's own normals and given ones, both (3, n), after the best rotation of these."""
    u, _, v = torch.linalg.svd(surface @ normal.T)
    cosine: Tensor = (surface * (u @ v @ normal)).sum(0)
    return cosine


def judge_turns(turns: Sequence[Turn], shown_by: str) -> Iterator[Finding]:
    """Yield a finding for normals that do not agree with surfaces. shown_by: what shows the surfaces, in words."""
    if not turns:
        return
    given, unsigned, turned, rounded = (median(turn[i] for turn in turns) for i in range(4))
    away = (1 - given / unsigned) / 2 if unsigned > ALONG else 0.0  # share of the pixels
    if away > SOME:
        negated = away > ALL
        where = "nearly all" if negated else "most" if given < 0 else f"{away:.0%} of the"
        verb = "shows" if shown_by == "position" else "show"
        found = f"point away from the camera in {where} pixels, as {shown_by} {verb}"
        expected = "normals that face the camera" + ("; these may be negated" if negated else "")
        yield Finding("normal", found, expected, False, negated)
    elif 1 - unsigned > OFF + rounded and 1 - turned < TURNED * (1 - unsigned):
        found = f"not perpendicular to the surfaces of {shown_by}, but one rotation of all makes them so"
        expected = "world space for both (for normals in camera space normal.space=camera, with cameras)"
        if shown_by != "position":  # which of the three is wrong cannot be told: depth was not compared with anything
            found += ": or depth or cameras are of another kind"
            expected += ", depth along the view axis and no z-buffer, cameras with y downwards in the picture"
        yield Finding("normal", found, expected)
    elif unsigned < APART - rounded:
        found = f"{math.degrees(math.acos(unsigned)):.0f}° off from the surfaces of {shown_by} on average"
        expected = "normals of these surfaces, of the same frame; or they are bent on purpose"
        yield Finding("normal", found, expected, False, True)
