"""A check that the light components are those of `color`: they add up to it, pixel by pixel.

Emission alone cannot exceed it either.
"""

from collections.abc import Iterator

import torch.nn.functional as F
from torch import Tensor

from nte.checking.values import MANY, Finding
from nte.frames.frame import Frame

SUMMED = ("color", "emission", "direct", "visibility", "glossy", "indirect")
OFF = 0.05  # least relative difference that counts; measured: below 0.02 in half floats
ENOUGH = 20  # least number of pixels that emit light
DARK = 0.05  # share of the mean light below which differences are compared with that
MORE, SOME = 0.25, 0.05  # share of the pixels that emit light in which color has less of it, and by how much
EXPECTED = "color = emission + direct · visibility + glossy + indirect"


class ComponentTally:
    """Tally of the pixels in which the light components of some frames do not add up."""

    def __init__(self) -> None:
        self._pixels = self._off = 0
        self._color = self._light = 0.0  # sums over frames, of color and of the components
        self._emit = self._exceed = 0  # pixels that emit light, and those in which it exceeds color

    def add(self, frame: Frame) -> None:
        """Add a PyTorch frame of batch 1; one that lacks some components tells nothing."""
        if "color" in frame and "emission" in frame:
            self._add_emission(*(frame[name].nan_to_num(0, 0, 0).sum(1) for name in ("color", "emission")))
        if any(name not in frame for name in SUMMED):
            return
        color = frame["color"]
        total = frame["emission"] + frame["direct"] * frame["visibility"] + frame["glossy"] + frame["indirect"]
        known = (color.isfinite() & total.isfinite()).all(1)
        color, total = color.nan_to_num(0, 0, 0), total.nan_to_num(0, 0, 0)
        least = OFF * color.abs().clamp(min=DARK * float(color.mean().abs()))
        self._pixels += known.numel()
        self._off += int((((color - total).abs() > least).any(1) & known).sum())
        self._color += float(color.sum())
        self._light += float(total.sum())

    def _add_emission(self, color: Tensor, emission: Tensor) -> None:
        # One sample may miss what emits in a part of its pixel only.
        emission = -F.max_pool2d(-emission[:, None], 3, 1, 1)[:, 0]
        emits = emission > DARK * float(color.mean())
        self._emit += int(emits.sum())
        self._exceed += int((emits & (emission > (1 + SOME) * color)).sum())

    def judge(self) -> Iterator[Finding]:
        """Yield a fault if components do not add up in over 1 % of the pixels, a doubt if emission exceeds color."""
        if self._off > MANY * self._pixels:
            times = f"{self._color / self._light:.3g}" if self._light > 0 else "infinitely many"
            where = f"in {self._off / self._pixels:.1%} of the pixels"
            yield Finding("color", f"is no sum of its components {where}, {times} times as bright in all", EXPECTED)
        elif self._exceed > MORE * self._emit and self._emit >= ENOUGH:
            found = f"is more than color in {self._exceed / self._emit:.0%} of the pixels that emit light"
            yield Finding("emission", found, "a part of color; or color is clamped", False, True)
