"""A check that depth and cameras predict the vectors of what stands still.

Each of the three may look right by itself. But depth in another unit than the cameras, distances from the camera, or
cameras of another frame or convention lead a point elsewhere than its vector. A picture in which everything moves by
itself before a moving camera looks the same, so this is a doubt and no fault.
"""

from collections.abc import Iterator, Sequence
from statistics import median
from typing import NamedTuple

import torch

from nte.checking.values import Finding
from nte.frames.frame import Frame
from nte.motion.camera import motion_of, points_from_depth

ENOUGH = 200  # least number of surface pixels that can tell
MOVES_PX = 2.0  # least median length of the vectors given, or predicted
NEAR_PX, NEAR = 0.5, 0.1  # vectors that are no farther apart agree: pixels, share of the longer one
MOST = 0.05  # cameras are in doubt if a smaller share of the pixels agrees


class Prediction(NamedTuple):
    """The share of a frame's surfaces whose vectors are predicted, and the median distance of the two vectors, px."""

    agree: float
    apart: float


def prediction(previous: Frame, current: Frame) -> Prediction | None:
    """Compare `motion` with the vectors of points at rest; None without depth, a moving camera, or visible motion.

    previous, current: consecutive PyTorch frames of batch 1 with motion.
    """
    cameras = current.view, current.projection, previous.view, previous.projection
    if "depth" not in current or any(matrix is None for matrix in cameras):
        return None
    view, projection, view_then, projection_then = (matrix.double() for matrix in cameras if matrix is not None)
    if torch.allclose(view, view_then):
        return None
    depth = current["depth"].double().nan_to_num(0, 0, 0)
    true = motion_of(points_from_depth(depth, view, projection), view_then, projection_then, depth > 0)
    given = current["motion"].double()
    hit = (depth > 0) & torch.cat([true, given], 1).isfinite().all(1, keepdim=True)
    if int(hit.sum()) < ENOUGH:
        return None
    lengths = [vectors.norm(dim=1, keepdim=True)[hit] for vectors in (given, true)]
    if max(float(length.median()) for length in lengths) < MOVES_PX:
        return None
    apart = (given - true).norm(dim=1, keepdim=True)[hit]
    agree = apart <= (NEAR * torch.maximum(*lengths)).clamp(min=NEAR_PX)
    return Prediction(float(agree.double().mean()), float(apart.median()))


def judge_cameras(pairs: Sequence[Prediction]) -> Iterator[Finding]:
    """Yield a doubt if hardly any vector is the one that depth and cameras predict. pairs: of plausible vectors."""
    if not pairs or (agree := median(pair.agree for pair in pairs)) >= MOST:
        return
    found = f"lead with depth to other vectors than motion in {1 - agree:.0%} of the pixels"
    apart = f"about {median(pair.apart for pair in pairs):.3g} px beside them"
    expected = "cameras of each frame in the units of depth, which is the distance along the view axis; or none"
    yield Finding("cameras", f"{found}, {apart}: one of the two is wrong, or everything moves", expected, False, True)
