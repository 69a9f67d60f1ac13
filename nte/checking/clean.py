"""A check that the reference has less noise than colour, and none of it.

It may be another noisy image of the same frames; or the noisy image itself, blurred. What colour has beside such a
reference goes along with the detail of the reference, since both are its noise. Beside any other reference, noise knows
nothing of the detail, or is against it, as far as the reference is noisy itself. Wide blurs and good denoisers leave
too little noise to tell, and a mean over a square goes along with nothing.
"""

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
BLOCK, BLOCKS = 16, 20  # pixels: side of the blocks that tell, and least number of them
# Least median correlation in the blocks that is told. Measured: −0.2 to 0.01 in right clips, up to 0.2 where the pixel
# filter of the reference alone has a deviation of 0.7 px; 0.38 to 0.45 for colour blurred by 1 px, 0.21 to 0.43 by 2 px
MADE_OF = 0.22
VARIES = 0.02, 1e-3  # least deviations in such a block, of what colour has beside the reference and of the reference
EXPECTED = "the same frames without noise"


class CleanTally:
    """Fine detail of colour and reference over frames: variances of both, and what they have in common.

    The picture is in both, and noise of their own in each: what is not common is noise.
    """

    def __init__(self) -> None:
        self._color = self._reference = self._common = 0.0
        self._blocks: list[Tensor] = []  # correlations

    def add(self, color: Tensor, reference: Tensor) -> None:
        """Add two images (3, H, W) of a frame, linear, without bad pixels."""
        scale = reference.mean().clamp(min=1e-12)
        images = [image.mean(0)[None] / scale for image in (color, reference)]
        ours, theirs = (F.avg_pool2d(image, AROUND, 1, AROUND // 2, count_include_pad=False) for image in images)
        self._blocks.append(_correlations(images[0] - images[1], images[1], theirs))
        alike = (ours < ALIKE * theirs) & (theirs < ALIKE * ours)
        if alike.float().mean() < MOST:
            return
        first, second = (_fine(image) * alike for image in images)
        self._color += float(first.square().mean())
        self._reference += float(second.square().mean())
        self._common += float((first * second).mean())

    def judge(self) -> Iterator[Finding]:
        """Yield a note if the reference is about as noisy as colour, or was made of it."""
        ours, theirs = self._color - self._common, self._reference - self._common
        if ours > NOISY * self._color and theirs > AS_NOISY * ours:
            yield Finding("reference", "is about as noisy as color", EXPECTED, False)
        blocks = torch.cat(self._blocks) if self._blocks else torch.zeros(0)
        if len(blocks) >= BLOCKS and (made_of := float(blocks.median())) > MADE_OF:
            found = f"follows the noise of color (a correlation of {made_of:.2f}), as color does that was blurred"
            yield Finding("reference", found, EXPECTED, False)


def _fine(image: Tensor) -> Tensor:
    """Compute what a pixel (1, H, W) differs by from its neighbours, compressed so that bright ones do not rule."""
    image = torch.log1p(image)
    return image - F.avg_pool2d(image, 3, 1, 1, count_include_pad=False)


def _correlations(beside: Tensor, reference: Tensor, level: Tensor) -> Tensor:
    """Correlate the fine detail of two images (1, H, W), in units of a level, in each block (n,) in which both vary."""
    if min(level.shape[1:]) < BLOCK:
        return level.new_zeros(0)
    level = level.clamp(min=1e-6)
    parts = []
    for image, least in zip((beside, reference), VARIES, strict=True):
        detail = image / level
        detail = detail - F.avg_pool2d(detail, AROUND, 1, AROUND // 2, count_include_pad=False)
        blocks = detail.unfold(1, BLOCK, BLOCK).unfold(2, BLOCK, BLOCK).flatten(3).flatten(0, 2)
        blocks = blocks - blocks.mean(1, keepdim=True)
        parts.append((blocks, blocks.norm(dim=1), least * BLOCK))
    (one, its_size, least), (other, other_size, other_least) = parts
    tells = (its_size > least) & (other_size > other_least)
    correlation: Tensor = ((one * other).sum(1) / (its_size * other_size))[tells]
    return correlation
