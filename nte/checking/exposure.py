"""A check that the reference has the scale and orientation of the colour: ratios of block means, over all frames."""

from collections.abc import Iterator

import torch
import torch.nn.functional as F
from torch import Tensor

from nte.checking.flips import FLIPS, ORIENTATION
from nte.checking.values import Finding
from nte.frames.frame import Frame

BLOCK = 16  # pixels, about
TOLD, FAILED = 1.2, 1.5  # least factors between colour and reference that are told, and that are a fault
ALIKE = 1.35  # blocks whose ratio is within this factor of the median agree
ENOUGH = 12  # least number of blocks that tell an orientation
UNLIKE = 0.05  # median difference of the logarithms from which on the blocks are not those of one picture
FLIPPED = 0.25  # the picture was turned over if that leaves at most this share of the difference
SAME = 1e-3  # relative difference of one image in half floats and in float32
AGREE = 0.7  # share of blocks that must agree; with fewer it is noise or another light, not another scale


class ExposureTally:
    """Sums of colour and reference over the frames of a clip, block by block."""

    def __init__(self) -> None:
        self._color: Tensor | None = None
        self._reference: Tensor | None = None
        self._same = True  # so far colour and reference are one image

    def add(self, frame: Frame) -> None:
        """Add a PyTorch frame of batch 1, if it has both channels; pixels that are bad in one of them count as 0."""
        if "color" not in frame or "reference" not in frame:
            return
        both = torch.cat([frame["color"], frame["reference"]], 1)
        good = (both.isfinite() & (both >= 0)).all(1, keepdim=True)
        apart = (frame["color"] - frame["reference"]).abs() > SAME * frame["reference"].abs()
        self._same &= not bool((apart & good).any())
        height, width = frame.size
        blocks = -(-height // BLOCK), -(-width // BLOCK)
        sums = F.adaptive_avg_pool2d(torch.where(good, both, 0.0), blocks).double()  # the same blocks when turned over
        color, reference = sums[:, :3].mean(1), sums[:, 3:].mean(1)
        self._color = color if self._color is None else self._color + color
        self._reference = reference if self._reference is None else self._reference + reference

    def judge(self) -> Iterator[Finding]:
        """Yield a finding if colour is brighter or darker than the reference by about the same factor everywhere.

        It is a fault if the factor exceeds 1.5 and over 70 % of the blocks agree; also if only one of the two is black,
        and if the two are each other's mirror image. A reference that is the colour itself is only noted.
        """
        if self._color is None or self._reference is None:
            return
        if self._same and float(self._color.sum()) > 0:
            yield Finding("reference", "is the same image as color", "the same frames without noise", False)
            return
        as_it_is = _unlike(self._color, self._reference)
        flipped = {how: _unlike(self._color, self._reference.flip(sides)) for how, sides in FLIPS.items()}
        how = min(flipped, key=lambda how: flipped[how])
        if as_it_is > UNLIKE and flipped[how] < FLIPPED * as_it_is:
            yield Finding("reference", f"shows the picture of color {how}", ORIENTATION)
            return
        color, reference = self._color.flatten(), self._reference.flatten()
        if not (float(color.sum()) > 0 and float(reference.sum()) > 0):
            if float(color.sum()) != float(reference.sum()):
                dark = "reference" if float(color.sum()) > 0 else "color"
                yield Finding(dark, "black everywhere", "the same light in color and reference")
            return
        lit = (reference > 0.01 * reference.mean()) & (color > 0)
        if not lit.any():
            return
        ratios = (color[lit] / reference[lit]).log()
        typical, of_means = float(ratios.median()), float((color.sum() / reference.sum()).log())
        agree = float(((ratios - typical).abs() < torch.tensor(ALIKE).log()).double().mean())
        closer = min(abs(typical), abs(of_means))  # noise moves the median one way, fireflies the mean the other
        if typical * of_means <= 0 or closer < float(torch.tensor(TOLD).log()):
            return
        factor = float(torch.tensor(typical).exp())
        found = f"color is {factor:.3g} times as bright (median of blocks; {agree:.0%} of them agree)"
        fault = closer > float(torch.tensor(FAILED).log()) and agree > AGREE
        yield Finding("reference", found, "the exposure and scale of color", fault)


def _unlike(color: Tensor, reference: Tensor) -> float:
    """Median difference, from their median, of the logarithms of the ratios of blocks (1, h, w); 0 if few are lit."""
    lit = (color > 0) & (reference > 0)
    if int(lit.sum()) < ENOUGH:
        return 0.0
    ratios = (color[lit] / reference[lit]).log()
    return float((ratios - ratios.median()).abs().median())
