"""A check that depth and cameras predict the vectors of what stands still.

Each of the three may look right by itself. But depth in another unit than the cameras, distances from the camera, or
cameras of another frame or convention lead a point elsewhere than its vector. A picture in which everything moves by
itself before a moving camera looks the same, so this is a doubt and no fault.
"""

from collections.abc import Iterator, Sequence
from statistics import median
from typing import NamedTuple

import torch
from torch import Tensor

from nte.checking.values import Finding
from nte.frames.frame import Frame
from nte.motion.camera import motion_of, points_from_depth

ENOUGH = 200  # least number of surface pixels that can tell
MOVES_PX = 2.0  # least median length of the vectors given, or predicted
NEAR_PX, NEAR = 0.5, 0.1  # vectors that are no farther apart agree: pixels, share of the longer one
ROUNDED_PX = 0.1  # cameras tell nothing if rounding of their places moves what they see by more
MOST = 0.05  # cameras are in doubt if a smaller share of the pixels agrees
SPREAD_PX = 0.5  # least median distance of predicted vectors from their median that tells a map
FITS_PX, FITS = 0.1, 0.02  # greatest distance of vectors that a map explains: pixels, share of their length
MAPPED = 0.7  # least share of the pixels that a map must explain
OTHER = 0.1  # least distance of a map from none that is told; measured: 0.005 at most in right clips
FITTED = 6  # times that a map is fitted, without the vectors of what moves by itself


class Prediction(NamedTuple):
    """The share of a frame's surfaces whose vectors are predicted, and the median distance of the two vectors, px."""

    agree: float
    apart: float
    fast: bool  # vectors are long enough for these two to tell
    map: Tensor | None  # (2, 2), takes the predicted vectors to those that are given; None if unknown
    mapped: float  # how far that takes them, as a share of their distance from each other; 0 without a map


def prediction(previous: Frame, current: Frame) -> Prediction | None:
    """Compare `motion` with the vectors of points at rest; None without depth or a camera that is known to move.

    previous, current: consecutive PyTorch frames of batch 1 with motion.
    """
    cameras = current.view, current.projection, previous.view, previous.projection
    if "depth" not in current or any(matrix is None for matrix in cameras):
        return None
    view, projection, view_then, projection_then = (matrix.double() for matrix in cameras if matrix is not None)
    if torch.allclose(view, view_then):
        return None
    depth = current["depth"].double().nan_to_num(0, 0, 0)
    points = points_from_depth(depth, view, projection)
    true = motion_of(points, view_then, projection_then, depth > 0)
    given = current["motion"].double()
    hit = (depth > 0) & torch.cat([true, given], 1).isfinite().all(1, keepdim=True)
    if int(hit.sum()) < ENOUGH:
        return None
    # Far from the origin the places of cameras are rounded, which moves the whole picture.
    rounded = view_then.clone()
    rounded[:, :3, 3] += torch.finfo(torch.float32).eps * view_then[:, :3, 3].abs().max()
    moved = motion_of(points, rounded, projection_then, depth > 0) - true
    if float(moved.norm(dim=1, keepdim=True)[hit].median()) > ROUNDED_PX:
        return None
    lengths = [vectors.norm(dim=1, keepdim=True)[hit] for vectors in (given, true)]
    fast = max(float(length.median()) for length in lengths) >= MOVES_PX
    apart = (given - true).norm(dim=1, keepdim=True)[hit]
    agree = apart <= (NEAR * torch.maximum(*lengths)).clamp(min=NEAR_PX)
    fitted = _map(*(vectors[0, :, hit[0, 0]] for vectors in (true, given)))
    return Prediction(float(agree.double().mean()), float(apart.median()), fast, *fitted)


def _map(true: Tensor, given: Tensor) -> tuple[Tensor | None, float]:
    """Fit the map (2, 2) that takes vectors `true` to those `given`, both (2, n), up to a shift; None if none fits.

    With it comes how far it takes them, as in Prediction: along an axis in which they hardly differ a map says nothing.
    """
    spread = true - true.median(1, keepdim=True).values
    size = float(spread.norm(dim=0).median())
    if size < SPREAD_PX:
        return None, 0.0
    rows = torch.cat([true, torch.ones_like(true[:1])])
    kept = torch.ones_like(true[0], dtype=torch.bool)
    for _ in range(FITTED):
        solved = torch.linalg.lstsq(rows[:, kept].T, given[:, kept].T).solution.T
        left = (given - solved @ rows).norm(dim=0)
        kept = left <= 2 * left.median() + 1e-6
    explained = left <= FITS_PX + FITS * true.norm(dim=0)
    if float(explained.double().mean()) < MAPPED:
        return None, 0.0
    taken = (solved[:, :2] - torch.eye(2)) @ spread
    return solved[:, :2], float(taken.norm(dim=0).median()) / size


def judge_cameras(pairs: Sequence[Prediction]) -> Iterator[Finding]:
    """Yield a doubt if hardly any vector is the one that depth and cameras predict, or all are a map of these.

    pairs: of vectors that are not implausible.
    """
    expected = "cameras of each frame in the units of depth, which is the distance along the view axis; or none"
    fast = [pair for pair in pairs if pair.fast]
    maps = [(pair.map, pair.mapped) for pair in pairs if pair.map is not None]
    if 2 * len(maps) > len(pairs):
        typical = torch.stack([fitted for fitted, _ in maps]).median(0).values
        kept = float(torch.linalg.matrix_norm(typical, ord=2))  # 0: vectors that are all alike follow no camera
        if min(kept, median(far for _, far in maps)) > OTHER:
            (xx, xy), (yx, yy) = ((typical * 100).round() / 100 + 0.0).tolist()
            along = f"{xx:.3g} times as long in x and {yy:.3g} times in y as depth and cameras show"
            across = f", and turned ({xy:.3g}, {yx:.3g})" if max(abs(xy), abs(yx)) > OTHER else ""
            yield Finding("motion", f"{along}{across}: one of the three is wrong", expected, False, True)
            return
    if fast and (agree := median(pair.agree for pair in fast)) < MOST:
        found = f"lead with depth to other vectors than motion in {1 - agree:.0%} of the pixels"
        apart = f"about {median(pair.apart for pair in fast):.3g} px beside them"
        yield Finding(
            "cameras", f"{found}, {apart}: one of the two is wrong, or everything moves", expected, False, True
        )
