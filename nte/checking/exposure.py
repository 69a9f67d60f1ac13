"""A check that the reference has the scale and orientation of the colour: means of blocks."""

from collections.abc import Iterator
from math import exp, log
from statistics import median
from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor

from nte.checking.clean import CleanTally
from nte.checking.colours import ColourTally
from nte.checking.flips import FLIPS, ORIENTATION
from nte.checking.tone import ToneTally
from nte.checking.values import MANY, Finding
from nte.frames.frame import Frame

BLOCK, ALONG = 16, 4  # pixels, about: a block's side in images of at least so many blocks along the shorter side
TOLD, FAILED = 1.2, 1.5  # least factors between colour and reference that are told, and that are a fault
ALIKE = 1.35  # blocks whose ratio is within this factor of the median agree
ENOUGH = 12  # least number of blocks that tell an orientation
LIT = 4  # least number of blocks that tell a scale
UNLIKE = 0.05  # median difference of the logarithms from which on the blocks are not those of one picture
FLIPPED = 0.25  # the picture was turned over if that leaves at most this share of the difference
SAME = 1e-3  # relative difference of one image in half floats and in float32
DIM = 0.01  # share of the mean light that counts as none
AGREE = 0.7  # share of blocks that must agree; with fewer it is noise or another light, not another scale
FRAMES = 0.1  # share of the frames with a scale of their own from which on it is a fault; a few are only told


class _Scale(NamedTuple):
    """The logarithm of how many times as bright colour is, in two ways, and the share of the blocks that agree."""

    of_blocks: float  # median
    of_means: float
    agree: float

    def without(self, blocks: float, means: float) -> float:
        """Return the logarithm that is left over these two; 0 if noise explains it.

        Noise moves the median of blocks one way, and fireflies move the mean the other.
        """
        ways = self.of_blocks - blocks, self.of_means - means
        return min(ways, key=abs) if ways[0] * ways[1] > 0 else 0.0


class ExposureTally:
    """Sums of colour and reference over the frames of a clip, block by block.

    one_noise: the two are equally noisy, as two seeds are.
    """

    def __init__(self, one_noise: bool = False) -> None:
        self._color: Tensor | None = None
        self._reference: Tensor | None = None
        self._lit = 0.0, 0.0  # greatest share of a frame's pixels in which color and reference show light
        self._same = True  # so far colour and reference are one image
        self._scales: dict[int, _Scale] = {}  # of frames that are lit
        self._tones, self._colours = ToneTally(one_noise), ColourTally()
        self._clean = None if one_noise else CleanTally()

    def add(self, frame: Frame) -> None:
        """Add a PyTorch frame of batch 1, if it has both channels; pixels that are bad in one of them count as 0."""
        if "color" not in frame or "reference" not in frame:
            return
        both = torch.cat([frame["color"], frame["reference"]], 1)
        good = (both.isfinite() & (both >= 0)).all(1, keepdim=True)
        light = frame["reference"].abs()  # half floats round what is hardly lit by more than a share of it
        apart = (frame["color"] - frame["reference"]).abs() > SAME * (light + DIM * light[light.isfinite()].mean())
        self._same &= not bool((apart & good).any())
        block = max(1, min(BLOCK, min(frame.size) // ALONG))
        height, width = (-(-side // block) for side in frame.size)
        # The blocks of a picture that is turned over are the same, turned over.
        light = torch.where(good, both, 0.0)
        sums = F.adaptive_avg_pool2d(light, (height, width)).double()
        color, reference = sums[:, :3].mean(1), sums[:, 3:].mean(1)
        lit = [float((image > 0).any(1).float().mean()) for image in (light[:, :3], light[:, 3:])]
        self._lit = max(self._lit[0], lit[0]), max(self._lit[1], lit[1])
        if (lit[0] > 0) != (lit[1] > 0):  # a frame without one of them says nothing of their scale
            return
        if scale := _scale(color, reference):
            self._scales[frame.index] = scale
        self._tones.add(frame)
        self._colours.add(light[0, :3], light[0, 3:], (height, width))
        if self._clean:
            self._clean.add(light[0, :3], light[0, 3:])
        self._color = color if self._color is None else self._color + color
        self._reference = reference if self._reference is None else self._reference + reference

    def judge(self) -> Iterator[Finding]:
        """Yield a finding if colour is brighter or darker than the reference by about the same factor everywhere.

        It is a fault if the factor exceeds 1.5 and over 70 % of the blocks agree; also if that factor differs by as
        much between frames, if only one of the two is black, if the two are each other's mirror image, if their colours
        differ, and if the factor depends on brightness. A reference that is the colour, or as noisy, is only noted.
        """
        if min(self._lit) == 0 and max(self._lit) > MANY:  # in the dark a few of many samples may find a light
            dark = "reference" if self._lit[0] else "color"
            yield Finding(dark, "black everywhere", "the same light in color and reference")
            return
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
        if self._clean:
            yield from self._clean.judge()
        if scale := _scale(self._color, self._reference):
            yield from self._judge_scale(scale)

    def not_judged(self) -> str:
        """Say why the reference could not be judged; "" if it could."""
        return self._tones.not_judged() if self._color is not None else ""

    def _judge_scale(self, whole: _Scale) -> Iterator[Finding]:
        scales = self._scales or {0: whole}
        blocks, means = (median(scale[i] for scale in scales.values()) for i in (0, 1))
        brighter = {frame: scale.without(blocks, means) for frame, scale in scales.items()}
        if off := [scales[i] for i, by in brighter.items() if scales[i].agree > AGREE and abs(by) > log(FAILED)]:
            factors = [exp(blocks), *(exp(scale.of_blocks) for scale in off)]
            between = f"{min(factors):.3g} to {max(factors):.3g}"
            found = f"color is {between} times as bright, as frames differ ({len(off)} of {len(scales)} do)"
            many = len(off) > max(1, FRAMES * len(scales))
            yield Finding("reference", found, "one exposure and scale for color and reference in all frames", many)
            if many:
                return
            whole = whole._replace(of_blocks=blocks, of_means=means)  # of the other frames
        if told := list(self._colours.judge()) or list(self._tones.judge(brighter)):
            yield from told
            return
        factor = whole.without(0, 0)
        if abs(factor) >= log(TOLD):
            agree = f"median of blocks; {whole.agree:.0%} of them agree"
            found = f"color is {exp(whole.of_blocks):.3g} times as bright ({agree})"
            fault = abs(factor) > log(FAILED) and whole.agree > AGREE
            yield Finding("reference", found, "the exposure and scale of color", fault)


def _scale(color: Tensor, reference: Tensor) -> _Scale | None:
    """Compare the means of blocks (1, h, w); None if too few are lit."""
    lit = (reference > 0.01 * reference.mean()) & (color > 0)
    if int(lit.sum()) < LIT:
        return None
    ratios = (color[lit] / reference[lit]).log()
    typical, of_means = float(ratios.median()), float((color.sum() / reference.sum()).log())
    return _Scale(typical, of_means, float(((ratios - typical).abs() < log(ALIKE)).double().mean()))


def _unlike(color: Tensor, reference: Tensor) -> float:
    """Median difference, from their median, of the logarithms of the ratios of blocks (1, h, w); 0 if few are lit."""
    lit = (color > 0) & (reference > 0)
    if int(lit.sum()) < ENOUGH:
        return 0.0
    ratios = (color[lit] / reference[lit]).log()
    return float((ratios - ratios.median()).abs().median())
