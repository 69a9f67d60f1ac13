"""Notes for the user about the values of an imported sequence."""

from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from nte.frames.channels import CHANNELS
from nte.frames.clip import Pixels

_CUT = -0.1, 2.1  # albedo beyond this range has another scale; a specular and a transmitted colour add up to 2
_COARSE = 0.1  # px: vectors in steps above this are worth a word
_MANY = 0.01  # share of the pixels beyond that range from which on the user is told


class OddValues:
    """Counter of unusable pixels, frame by frame: NaN or infinite values, negative radiance, unknown (NaN) vectors."""

    def __init__(self) -> None:
        self._pixels: Counter[str] = Counter()
        self._first: dict[str, Path] = {}

    def look(self, channels: Mapping[str, Pixels], files: Mapping[str, Path]) -> None:
        """Add a frame of channels (C, H, W). files: channel → the file that it was read from."""
        for name, values in channels.items():
            usable = np.isfinite(values)
            if CHANNELS[name].kind in ("radiance", "reflectance"):
                usable &= values >= 0
            if odd := int((~usable).any(0).sum()):
                self._pixels[name] += odd
                self._first.setdefault(name, files[name])

    def notes(self) -> Iterator[str]:
        """Write a line for each channel that has unusable pixels, naming the first file with some."""
        for name, number in self._pixels.items():
            where = f"{number} pixels of {name}, first in {self._first[name]}"
            if CHANNELS[name].kind == "motion":
                yield f"unknown: {where}; they move as the camera turns or as their neighbours"
            else:
                yield f"bad: {where}: NaN, infinite or negative"


class LostValues:
    """Counter of values that are lost because a map is wrong: albedo of another scale, depth of another sign."""

    def __init__(self) -> None:
        self._pixels = self._cut = self._hits = 0
        self._albedo, self._depth = Range(), Range()

    def look(self, stored: Mapping[str, Pixels], ours: Mapping[str, Pixels]) -> None:
        """Add a frame of channels (C, H, W), before and after conversion; depths of the sky are infinite."""
        if "albedo" in stored:
            values = stored["albedo"]
            self._albedo.add(values)
            self._pixels += values[0].size
            self._cut += int(((values < _CUT[0]) | (values > _CUT[1])).any(0).sum())
        if "depth" in stored:
            depth = np.abs(stored["depth"])
            self._depth.add(stored["depth"][depth > 0])
            self._hits += int((ours["depth"] > 0).sum())

    def notes(self) -> Iterator[str]:
        """Write a line for albedo if over 1 % of its pixels are cut, and for depth if no pixel shows a surface."""
        if self._cut > _MANY * self._pixels:
            share = f"{self._cut / self._pixels:.0%} of the pixels of albedo, which is stored as {self._albedo}"
            yield f"cut to [0, 1]: {share}: if that is another scale, say it with channels.albedo.scale"
        if self._depth.known and not self._hits:
            hint = "see depth.scale, negative where depth counts downwards, and depth.sky"
            yield f"no pixel shows a surface: depth is stored as {self._depth}: {hint}"


class CoarseVectors:
    """Record of vectors that are stored in coarse steps: half floats around 0.5 are 1 px of a full HD image apart."""

    def __init__(self) -> None:
        self._steps: dict[str, float] = {}

    def look(self, name: str, step: float) -> None:
        """Add a channel of vectors of a frame, whose values are `step` pixels apart."""
        self._steps[name] = max(step, self._steps.get(name, 0.0))

    def notes(self) -> Iterator[str]:
        """Write a line for each channel whose steps are greater than a tenth of a pixel."""
        for name, step in self._steps.items():
            if step > _COARSE:
                yield f"coarse: {name} is stored in half floats, in steps of {step:.2g} px: write 32-bit floats"


class Range:
    """The range of the finite values that were added."""

    def __init__(self) -> None:
        self._low, self._high = np.inf, -np.inf

    def add(self, values: Pixels) -> None:
        """Add an array of any shape."""
        if (finite := values[np.isfinite(values)]).size:
            self._low, self._high = min(self._low, float(finite.min())), max(self._high, float(finite.max()))

    @property
    def known(self) -> bool:
        """Whether there was a finite value."""
        return self._low <= self._high

    def __str__(self) -> str:
        return f"{self._low:.4g} to {self._high:.4g}"
