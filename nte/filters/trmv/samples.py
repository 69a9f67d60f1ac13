"""Which of the samples, and which of the vectors, that rays have found may enter a mean.

A shadow ray that grazes its receiver's plane, or a reflection near a focus, gives a vector of any length, and one
of 10 000 px would move the mean of a whole footprint.
"""

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from nte.motion.box import box_mean

TINY = 1e-30  # weights up to here are none: they are what is left of an underflow, and cannot be divided by
AROUND, APART = 5, 2  # a vector is compared with those of 5×5 pixels, every other one
DEVIATIONS = 3.0  # of those around: more than a tenth of them would have to be wrong to hide each other
ENOUGH = 8  # others, to judge by
ROUGHLY = 1.0  # px: vectors this much apart are alike, whatever the deviation


class OfUsable(NamedTuple):
    """Light (N, C, H, W), 0 where nothing is known; and where something is: (N, 1, H, W) bool, None everywhere."""

    light: Tensor
    known: Tensor | None


def of_usable(smooth: Callable[[Tensor], Tensor], light: Tensor, usable: Tensor | None) -> OfUsable:
    """`smooth`, a weighted mean, of the pixels of light (N, C, H, W) that tell something.

    usable (N, 1, H, W): 1 for those, 0 for others, which would count as black; None: all of them.
    """
    if usable is None or bool((usable > 0).all()):
        return OfUsable(smooth(light), None)
    parts = smooth(torch.cat([light * usable, usable], 1))
    known = parts[:, -1:] > TINY
    return OfUsable(torch.where(known, parts[:, :-1] / parts[:, -1:].clamp(min=TINY), 0.0), known)


def believable(motion: Tensor) -> tuple[Tensor, Tensor]:
    """(1 or 0 for each vector (N, 1, H, W), the vectors (N, 2, H, W), 0 where they are not believed).

    Believed is a finite vector that does not cross more than the image's diagonal, and lies within 3 deviations of
    the mean of the others around it; where those are too few to judge by, it is believed.
    """
    height, width = motion.shape[-2:]
    known = (motion.square().sum(1, keepdim=True) <= height**2 + width**2).to(motion.dtype)  # false for NaN
    motion = torch.where(known > 0, motion, 0.0)
    sums = box_mean(torch.cat([known, motion, motion.square()], 1), AROUND, APART)
    # Of the others: the sums without the vector itself. Means over the pixels that exist, so counted in such shares.
    own = box_share(motion)
    others = sums[:, :1] - own * known
    count = others.clamp(min=TINY)
    mean = (sums[:, 1:3] - own * motion) / count
    variance = ((sums[:, 3:] - own * motion.square()) / count - mean.square()).clamp(min=0)
    apart = (motion - mean).square().sum(1, keepdim=True)
    alike = apart <= (DEVIATIONS * variance.sum(1, keepdim=True).sqrt() + ROUGHLY).square()
    believed = known * (alike | (others < (ENOUGH - 0.5) * own))
    return believed, motion * believed


def box_share(like: Tensor) -> Tensor:
    """(1, 1, H, W): what a pixel itself contributes to its mean of AROUND × AROUND pixels, APART from each other."""
    shares = []
    for length in like.shape[-2:]:
        place = torch.arange(length, device=like.device)
        before, after = ((room // APART).clamp(max=AROUND // 2) for room in (place, length - 1 - place))
        shares.append(1 / (before + after + 1).to(like.dtype))
    return (shares[0][:, None] * shares[1])[None, None]
