"""A check that the reference has less noise than colour: it may be another noisy image of the same frames."""

from collections.abc import Iterator

import torch
import torch.nn.functional as F
from torch import Tensor

from nte.checking.values import Finding

# Least variance of the reference's noise that is told, in shares of that of colour; measured in 24 rendered clips:
# up to 0.08 for their references, 0.84 to 1.4 for two images of as many samples where they have noise.
AS_NOISY = 0.7
NOISY = 0.2  # least share of colour's fine detail that must be noise
AROUND, ALIKE = 7, 2.0  # pixels: side of the square in which both are as bright, up to this factor, or not one picture
MOST = 0.5  # least share of such pixels in a frame


class CleanTally:
    """Fine detail of colour and reference over frames: variances of both, and what they have in common.

    The picture is in both, and noise of their own in each: what is not common is noise.
    """

    def __init__(self) -> None:
        self._color = self._reference = self._common = 0.0

    def add(self, color: Tensor, reference: Tensor) -> None:
        """Add two images (3, H, W) of a frame, linear, without bad pixels."""
        scale = reference.mean().clamp(min=1e-12)
        images = [image.mean(0)[None] / scale for image in (color, reference)]
        ours, theirs = (F.avg_pool2d(image, AROUND, 1, AROUND // 2, count_include_pad=False) for image in images)
        alike = (ours < ALIKE * theirs) & (theirs < ALIKE * ours)
        if alike.float().mean() < MOST:
            return
        first, second = (_fine(image) * alike for image in images)
        self._color += float(first.square().mean())
        self._reference += float(second.square().mean())
        self._common += float((first * second).mean())

    def judge(self) -> Iterator[Finding]:
        """Yield a note if the reference is about as noisy as colour."""
        ours, theirs = self._color - self._common, self._reference - self._common
        if ours > NOISY * self._color and theirs > AS_NOISY * ours:
            yield Finding("reference", "is about as noisy as color", "the same frames without noise", False)


def _fine(image: Tensor) -> Tensor:
    """Compute what a pixel (1, H, W) differs by from its neighbours, compressed so that bright ones do not rule."""
    image = torch.log1p(image)
    return image - F.avg_pool2d(image, 3, 1, 1, count_include_pad=False)
