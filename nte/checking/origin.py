"""A check that depth is counted from the camera, where there are positions: from another plane it is linear as well.

The camera sees a point in its own pixel, so x z and y z are linear functions of the point, if x and y are its pixel and
z its depth. If depth is z + k, or k − z, then x times depth is that plus k times x. So k is what x and y weigh beside a
linear function. Where the camera sees no perspective, x is linear itself, and nothing is known.
"""

from collections.abc import Iterator, Sequence
from statistics import median
from typing import NamedTuple

import torch
from torch import Tensor

from nte.checking.values import Finding

LEFT = 0.3  # the plane explains what is not linear if it leaves at most this share of it
LEAST_PX = 0.5  # pixels: what is not linear must be more than this; jitter moves points by less
AWAY = 0.1  # least distance of the plane from the camera that is told, as a share of the median depth


class Origin(NamedTuple):
    """Depth of the camera, in units of the median depth, and what is not linear with it at 0, and there (pixels)."""

    place: float
    without: float
    left: float


def origin_of(points: Tensor, pixels: Tensor, depth: Tensor) -> Origin:
    """Find the depth (n,) of the camera that sees points (3, n) at pixels (2, n)."""
    centred = points - points.mean(1, keepdim=True)
    linear = torch.cat([centred / centred.norm(dim=0).max().clamp(min=1e-30), torch.ones_like(depth)[None]]).T
    unit = depth / depth.median()
    both = torch.stack([pixels, pixels * unit], 2)  # (2, n, 2)
    rest = both - linear @ (torch.linalg.pinv(linear) @ both)
    alone, times = rest.unbind(2)
    place = float((alone * times).sum() / alone.square().sum().clamp(min=1e-30))
    without, left = (float(values.abs().median()) for values in (times, times - place * alone))
    return Origin(place, without, left)


def judge_origins(frames: Sequence[Origin]) -> Iterator[Finding]:
    """Yield a fault if depth is counted from elsewhere than the camera. frames: those whose depth is linear."""
    if not frames:
        return
    place, without, left = (median(frame[i] for frame in frames) for i in range(3))
    if abs(place) > AWAY and without > LEAST_PX and left < LEFT * without:
        found = f"counted from a plane {abs(place):.3g} times the median depth away from the camera, as position shows"
        yield Finding("depth", found, "the distance along the view axis")
