"""A check that the light components are those of `color`: they add up to it, pixel by pixel."""

from collections.abc import Iterator

from nte.checking.values import MANY, Finding
from nte.frames.frame import Frame

SUMMED = ("color", "emission", "direct", "visibility", "glossy", "indirect")
OFF = 0.05  # least relative difference that counts; measured: below 0.02 in half floats
DARK = 0.05  # share of the mean light below which differences are compared with that
EXPECTED = "color = emission + direct · visibility + glossy + indirect"


class ComponentTally:
    """Tally of the pixels in which the light components of some frames do not add up."""

    def __init__(self) -> None:
        self._pixels = self._off = 0
        self._color = self._light = 0.0  # sums over frames, of color and of the components

    def add(self, frame: Frame) -> None:
        """Add a PyTorch frame of batch 1; one that lacks some components tells nothing."""
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

    def judge(self) -> Iterator[Finding]:
        """Yield a fault if the components do not add up in over 1 % of the pixels."""
        if self._off > MANY * self._pixels:
            times = f"{self._color / self._light:.3g}" if self._light > 0 else "infinitely many"
            where = f"in {self._off / self._pixels:.1%} of the pixels"
            yield Finding("color", f"is no sum of its components {where}, {times} times as bright in all", EXPECTED)
