"""Selection of the samples and vectors that may enter a mean.

A shadow ray that grazes its receiver's plane, or a reflection near a focus, gives a vector of any length, and a single
one of 10 000 px would shift the mean of a whole footprint.
"""

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from nte.motion.box import box_count, box_mean

TINY = 1e-30  # weights up to this count as 0: they are left over from an underflow, and unfit as divisors
AROUND, APART = 5, 2  # a vector is compared with those of 5×5 pixels, 2 px apart
DEVIATIONS = 3.0  # of the vectors around; outliers hide each other only if more than a tenth of the vectors are
ENOUGH = 8  # least number of other vectors for a judgement
ROUGHLY = 1.0  # px; vectors that differ by less are alike, whatever the deviation


class OfUsable(NamedTuple):
    """Light (N, C, H, W), 0 where unknown, and the mask (N, 1, H, W), bool, of where it is known; None: everywhere."""

    light: Tensor
    known: Tensor | None


def of_usable(smooth: Callable[[Tensor], Tensor], light: Tensor, usable: Tensor | None) -> OfUsable:
    """Apply `smooth`, a weighted mean, to the usable pixels of light (N, C, H, W) only.

    usable (N, 1, H, W): 1 for usable pixels, 0 for others, which would count as black; None: all are usable.
    """
    if usable is None or bool((usable > 0).all()):
        return OfUsable(smooth(light), None)
    parts = smooth(torch.cat([light * usable, usable], 1))
    known = parts[:, -1:] > TINY
    return OfUsable(torch.where(known, parts[:, :-1] / parts[:, -1:].clamp(min=TINY), 0.0), known)


def believable(motion: Tensor) -> tuple[Tensor, Tensor]:
    """Find the vectors that agree with those around them.

    Returns 1 or 0 for each vector, (N, 1, H, W), and the vectors (N, 2, H, W), px, 0 where they are not believed. A
    vector is believed if it is finite, not longer than the image's diagonal, and within 3 deviations of the mean of the
    other vectors around it. Where these are too few to judge by, it is believed.
    """
    height, width = motion.shape[-2:]
    known = (motion.square().sum(1, keepdim=True) <= height**2 + width**2).to(motion.dtype)  # false for NaN
    motion = torch.where(known > 0, motion, 0.0)
    sums = box_mean(torch.cat([known, motion, motion.square()], 1), AROUND, APART)
    # Sums over the other vectors, without the vector itself. `box_mean` divides by the number of pixels that exist, so
    # each pixel counts as such a share.
    own = 1 / box_count(motion, AROUND, APART).to(motion.dtype)
    others = sums[:, :1] - own * known
    count = others.clamp(min=TINY)
    mean = (sums[:, 1:3] - own * motion) / count
    variance = ((sums[:, 3:] - own * motion.square()) / count - mean.square()).clamp(min=0)
    apart = (motion - mean).square().sum(1, keepdim=True)
    alike = apart <= (DEVIATIONS * variance.sum(1, keepdim=True).sqrt() + ROUGHLY).square()
    believed = known * (alike | (others < (ENOUGH - 0.5) * own))
    return believed, motion * believed
