"""A check that depth keeps its unit from frame to frame: some renderers scale each frame to its own range.

A rigid motion takes a point seen at (x, y) with depth z to depth a z x + b z y + c z + d in the frame before. With x
and y from the middle of the picture, c is the cosine of the camera's turn: hardly below 1, whatever its lens. So
z' / z = a x + b y + c + d / z, and c is the ratio of the units of the two frames. Of a single plane, whose 1 / z is a
linear function of x and y, c is unknown; but where nothing moves in the picture, depth stays as it is.
"""

from collections.abc import Iterator, Sequence

import torch
import torch.nn.functional as F
from torch import Tensor

from nte.checking.textures import ONE_SURFACE
from nte.checking.values import Finding
from nte.checking.votes import STILL_PX
from nte.frames.frame import Frame
from nte.motion.geometric import traditional_motion
from nte.motion.warp import fetch_nearest, pixel_centres, warp

ENOUGH = 500  # least number of pixels that can tell
SAMPLED = 8192  # pixels of a pair of frames that are looked at, up to twice as many
FITS = 0.01  # greatest median error of z' / z, relative
SPREAD, BESIDE = 0.05, 0.25  # least distance of 1 / z, relative, from one plane, and least share of pixels beside it
AT_REST = 0.05  # least share beside it of the pixels that one motion explains: all the rest may move by itself
OTHER = 1.1  # least ratio of the units that is told; measured: 0.98 to 1.003 in 17 clips with right depth
ONCE = 2.0  # least ratio that is a fault even if it is seen only once
SURELY = 1.25  # least ratio that is a fault: water, which moves as no rigid thing does, has 1.13


def unit_of(previous: Frame, current: Frame) -> float | None:
    """Compute how many times as large numbers the depth of `current` has as that of `previous`; None if unknown.

    Both are consecutive PyTorch frames of batch 1 with motion and depth.
    """
    vectors = traditional_motion(current["motion"])
    at = pixel_centres(vectors.motion) + vectors.motion
    # Between pixels of a plane 1 / z is exact.
    depth, before = current["depth"], 1 / warp(1 / previous["depth"].clamp(min=1e-30), vectors.motion).image
    known = vectors.valid & _inside(depth) & (fetch_nearest(_inside(previous["depth"]).float(), at) > 0)
    if int(known.sum()) < ENOUGH:
        return None
    if float(vectors.motion.norm(dim=1, keepdim=True)[known].median()) < STILL_PX:
        return float((depth / before)[known].median())
    height, width = current.size
    half = torch.tensor([width / 2, height / 2]).view(1, 2, 1, 1)
    image = torch.cat([torch.ones_like(depth), (pixel_centres(depth) - half) / max(width, height)], 1)
    step = max(1, int(known.sum()) // SAMPLED)
    plane, z, then = (values[0, :, known[0, 0]][:, ::step].T.double() for values in (image, depth, before))
    near = z.median() / z
    if float(_fit(plane, near)[1].quantile(1 - BESIDE)) < SPREAD:
        return None
    solved, errors = _fit(torch.cat([plane, near], 1), then / z)
    if float(errors.median()) > FITS * float(solved[0].abs()) or float(solved[0]) <= 0:
        return None
    rigid = errors <= FITS * solved[0].abs()
    if float(_fit(plane[rigid], near[rigid])[1].quantile(1 - AT_REST)) < SPREAD:
        return None
    return 1 / float(solved[0])


def _fit(rows: Tensor, values: Tensor) -> tuple[Tensor, Tensor]:
    """Fit values (n, 1) by rows (n, k), without what moves by itself: the solution (k, 1), and all errors (n,)."""
    kept = torch.ones_like(values[:, 0], dtype=torch.bool)
    for _ in range(4):
        solved = torch.linalg.lstsq(rows[kept], values[kept]).solution
        errors = (rows @ solved - values).abs()[:, 0]
        kept = errors <= 2 * errors.median() + 1e-6
    return solved, errors


def judge_units(ratios: Sequence[float], confirmed: Sequence[float] = ()) -> Iterator[Finding]:
    """Yield a fault if the unit surely changes in two pairs of frames at least, which no cut does; else a note.

    Once is enough where the picture confirms the vectors, which it never does at a cut. ratios: of each pair of frames
    that tells; confirmed: those of pairs with confirmed vectors.
    """
    changed = [ratio for ratio in ratios if not 1 / OTHER < ratio < OTHER]
    if changed:
        times = f"{min(changed):.3g} to {max(changed):.3g} times as large"
        found = f"{times} as in the frame before, in {len(changed)} of {len(ratios)} frames that tell"
        surely = sum(not 1 / SURELY < ratio < SURELY for ratio in changed) > 1
        surely |= any(not 1 / ONCE < ratio < ONCE for ratio in confirmed)
        expected = "one unit in all frames: no frame scaled to its own range"
        yield Finding("depth", found, expected, surely)


def _inside(depth: Tensor) -> Tensor:
    """Mark the pixels (1, 1, H, W) whose 3×3 pixels around show one surface."""
    low, high = -F.max_pool2d(-depth, 3, 1, 1), F.max_pool2d(depth, 3, 1, 1)
    return (low > 0) & (high < ONE_SURFACE * low)
