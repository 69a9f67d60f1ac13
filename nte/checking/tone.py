"""A check that the reference is a multiple of the colour, as linear light is: no tone curve, no encoding, no clipping.

Small blocks of pixels are sorted into bins by the brightness that half of their pixels have in the reference. Colour
and reference are compared in the other half, bin by bin. Neither image's noise changes the ratio of these means, since
the bins depend on pixels that are not compared; a curve does, as it treats dark and bright light differently. A pixel
filter spreads noise over neighbours: a curve must be seen, too, where blocks are sorted by what is around them, and
only their middles are compared.
"""

from collections.abc import Iterator, Mapping
from math import exp, log

import torch
import torch.nn.functional as F
from torch import Tensor

from nte.checking.values import Finding
from nte.frames.frame import Frame

SIDE = 4  # pixels: side of a block
A_STOP = 2  # bins in a factor of two of brightness
BINS, MIDDLE = 512, 256  # bins from 2^−128 to 2^128: radiance may have any unit
ENOUGH, SHARE = 120, 0.004  # least number of values in a bin that tells, and least share of all values
CHANNELS = 3  # the noise of three channels is that of one
SURE = 3.0  # standard errors of the mean of a bin that count as noise
TRUSTED = 0.2  # greatest relative standard error of a bin that tells: fewer samples may have missed all the light
BENT = 1.05  # least ratio between bins, beyond noise; measured: 0.99 at most in right clips, 1.07 to 30 with curves
# The same where blocks are sorted by what is around them, which tells bright from dark less well.
BENT_AROUND, SURE_AROUND = 1.02, 2.0
STOPS = 2  # stops of brightness that the bins must span to tell a gentle curve from none
CAUSES = "a tone curve, an encoding, clipped, or another picture, such as a blurred one, or one of another frame"
EXPECTED = "a multiple of color: linear light, not clipped, no tone curve, not encoded for display"


class ToneTally:
    """Sums of colour and reference by brightness of the reference, of each frame.

    one_noise: the two are equally noisy, and are sorted by the brightness of their sum.
    """

    def __init__(self, one_noise: bool = False) -> None:
        self._one_noise = one_noise
        # Frame → (2, 4, BINS), by half of each block, by what is around: count, color, its square, reference
        self._sums: dict[int, Tensor] = {}

    def add(self, frame: Frame) -> None:
        """Add a PyTorch frame of batch 1, if it has both channels and a block of pixels; bad pixels count as 0."""
        if "color" not in frame or "reference" not in frame or min(frame.size) < SIDE:
            return
        both = torch.stack([frame["color"][0], frame["reference"][0]]).double()
        good = (both.isfinite() & (both >= 0)).all(0).all(0)
        height, width = (side // SIDE for side in frame.size)
        cut = torch.where(good, both, 0.0)[..., : height * SIDE, : width * SIDE]
        blocks = cut.reshape(2, 3, height, SIDE, width, SIDE).transpose(3, 4)
        odd = (torch.arange(SIDE).unsqueeze(1) + torch.arange(SIDE)) % 2 == 1
        sides = F.pad(blocks.mean((-2, -1)), (1, 1, 1, 1), mode="replicate")
        around = (sides[..., :-2, 1:-1] + sides[..., 2:, 1:-1] + sides[..., 1:-1, :-2] + sides[..., 1:-1, 2:]) / 4
        half = self._binned(blocks[..., odd].mean(-1), blocks[..., ~odd].mean(-1))
        middle = self._binned(around, blocks[..., 1:-1, 1:-1].mean((-2, -1)))
        self._sums[frame.index] = torch.stack([half, middle])

    def _binned(self, sorting: Tensor, compared: Tensor) -> Tensor:
        """Add up (4, BINS) values of blocks, both (2, 3, h, w), by the brightness of `sorting`."""
        sorting = sorting.flatten(1)
        means = sorting.mean(1, keepdim=True).clamp(min=1e-30)  # a sum of equal parts, whatever their scales
        sorts = (sorting / means).mean(0) * means[1] if self._one_noise else sorting[1]
        color, reference = compared.flatten(1)
        lit = sorts > 0
        bins = (A_STOP * sorts[lit].log2()).floor().long().add(MIDDLE).clamp(0, BINS - 1)
        weights = torch.ones_like(color), color, color.square(), reference
        return torch.stack([torch.bincount(bins, weight[lit], BINS) for weight in weights])

    def judge(self, brighter: Mapping[int, float]) -> Iterator[Finding]:
        """Yield a fault if the ratio of colour and reference depends on how bright the reference is.

        brighter: frame → logarithm of how many times as bright as in other frames its colour is: told elsewhere.
        """
        if self._bend(brighter, False) > log(BENT) and self._bend(brighter, True) > log(BENT_AROUND):
            ratios, errors, at = self._ratios(brighter)
            low, high = ratios + SURE * errors, ratios - SURE * errors
            ends = sorted((int(low.argmin()), int(high.argmax())))
            places = [f"{exp(ratios[i]):.3g} times where it is {exp(at[i]):.3g}" for i in ends]
            found = f"is no multiple of color, which is {' and '.join(places)} as bright"
            yield Finding("reference", f"{found}: {CAUSES}", EXPECTED)

    def not_judged(self) -> str:
        """Say why a curve could not be seen; "" if it could."""
        *_, at = self._ratios({})
        if not self._sums:
            return ""
        span = float(at[-1] - at[0]) / log(2) if len(at) else 0.0
        return "" if span >= STOPS else f"its brightness spans {span:.2g} stops, {STOPS} are needed to see a tone curve"

    def _bend(self, brighter: Mapping[int, float], around: bool) -> float:
        """Return the greatest difference of the logarithms of the ratios, beyond noise."""
        ratios, errors, _ = self._ratios(brighter, around)
        noise = (SURE_AROUND if around else SURE) * errors
        return float((ratios - noise).max() - (ratios + noise).min()) if len(ratios) else 0.0

    def _ratios(self, brighter: Mapping[int, float], around: bool = False) -> tuple[Tensor, Tensor, Tensor]:
        """Logarithms (bins,) of colour over reference, their standard errors, and logarithms of the reference."""
        total = torch.zeros(4, BINS, dtype=torch.float64)
        for index, sums in self._sums.items():
            gain = exp(-brighter.get(index, 0.0))
            total += sums[int(around)] * sums.new_tensor([1, gain, gain**2, 1]).unsqueeze(1)
        count, color, square, reference = total
        tells = (count >= max(ENOUGH, SHARE * float(count.sum()))) & (color > 0) & (reference > 0)
        count, color, square, reference = (values[tells] for values in (count, color, square, reference))
        spread = (square / count - (color / count).square()).clamp(min=0).sqrt()
        error = spread / (count / CHANNELS).sqrt() / (color / count)
        trusted = error < TRUSTED
        return (color / reference).log()[trusted], error[trusted], (reference / count).log()[trusted]
