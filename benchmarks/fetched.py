"""Quality of motion vectors: clean history, fetched with them, is compared with the clean current frame.

Vectors of shadows and reflections are random, one sample per pixel and frame, so the expectation over samples counts.
Motion is (S, 2, H, W) in pixels, current → previous: S samples for one frame.
"""

from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor

from nte.filters.trmv.glossy import spread_noise
from nte.motion.warp import warp


class Fetched(NamedTuple):
    """What samples of a vector fetched; all fields are meaningless where `inside` is 0."""

    image: Tensor  # (1, C, H, W) mean over samples, which a filter that accumulates approaches
    error: Tensor  # (1, 1, H, W) expected error of one sample: mean over samples and channels of |history − now|
    inside: Tensor  # (1, 1, H, W) share of samples that end inside the previous frame; only these count

    def error_of_mean(self, now: Tensor) -> Tensor:
        """Return the mean over channels of |mean of what was fetched − now|, (1, 1, H, W)."""
        return (self.image - now).abs().mean(1, keepdim=True)


def fetch(history: Tensor, now: Tensor, motion: Tensor) -> Fetched:
    """Fetch the previous frame's `history` (1, C, H, W) bilinearly, and compare it with `now` (1, C, H, W)."""
    found = warp(history.expand(len(motion), -1, -1, -1), motion)
    count = found.valid.sum(0, keepdim=True)

    def mean(values: Tensor) -> Tensor:
        return torch.where(found.valid, values, 0).sum(0, keepdim=True) / count.clamp(min=1)

    error = (found.image - now).abs().mean(1, keepdim=True)
    return Fetched(mean(found.image), mean(error), count / len(motion))


def fill(vectors: Tensor, instance: Tensor, radius: int) -> Tensor:
    """Fill the gaps (NaN) of vectors (S, C, H, W) from the footprint of each sample.

    A gap takes the mean of the vectors of the same sample within `radius` pixels on the same object, given by instance
    (1, 1, H, W), as the filter of Zeng et al. 2021 splats them. NaN stays where there are no such vectors.
    """
    known = vectors.isfinite().all(1, keepdim=True)
    values = torch.cat([known.to(vectors), torch.where(known, vectors, 0)], 1)
    sums = torch.zeros_like(values)
    for number in instance.unique():  # type: ignore[no-untyped-call]
        mine = instance == number
        around = F.avg_pool2d(values * mine, 2 * radius + 1, 1, radius, divisor_override=1)
        sums = torch.where(mine, around, sums)
    return torch.where(known, vectors, sums[:, 1:] / sums[:, :1].round())


def draw(mean: Tensor, covariance: Tensor, generator: torch.Generator) -> Tensor:
    """Draw a vector (S, 2, H, W) from each Gaussian of mean (S, 2, H, W) and covariance (S, 3, H, W) XX XY YY."""
    return mean + spread_noise(torch.randn(mean.shape, generator=generator), covariance)


def is_planar(normal: Tensor, instance: Tensor, radius: int = 2, tolerance: float = 0.01) -> Tensor:
    """Return where the object's normals within `radius` pixels are equal but for `tolerance`: (1, 1, H, W) bool.

    normal: (1, 3, H, W). instance: (1, 1, H, W), the number of each pixel's object.
    """
    size = 2 * radius + 1
    same = _windows(instance, size, pad=-1) == instance[:, :, None]
    turned = (_windows(normal, size, pad=0.0) - normal[:, :, None]).norm(dim=1, keepdim=True)
    planar: Tensor = (turned <= tolerance).logical_or(~same).all(2)
    return planar


def _windows(values: Tensor, size: int, pad: float) -> Tensor:
    """The size × size pixels around each pixel, (N, C, size², H, W); `pad` beyond the border."""
    count, channels, height, width = values.shape
    padded = F.pad(values, (size // 2,) * 4, value=pad)
    return F.unfold(padded, size).view(count, channels, size**2, height, width)
