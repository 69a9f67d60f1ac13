"""What a user should hear of the values of an imported sequence."""

from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from nte.frames.channels import CHANNELS
from nte.frames.clip import Pixels


class OddValues:
    """Counts unusable values, frame by frame: NaN and infinite ones, negative radiance, unknown (NaN) vectors."""

    def __init__(self) -> None:
        self._pixels: Counter[str] = Counter()
        self._first: dict[str, Path] = {}

    def look(self, channels: Mapping[str, Pixels], files: Mapping[str, Path]) -> None:
        """Add a frame of channels (C, H, W); files: where each of them was read."""
        for name, values in channels.items():
            usable = np.isfinite(values)
            if CHANNELS[name].kind in ("radiance", "reflectance"):
                usable &= values >= 0
            if odd := int((~usable).any(0).sum()):
                self._pixels[name] += odd
                self._first.setdefault(name, files[name])

    def notes(self) -> Iterator[str]:
        """A line for each channel that has some, with the file of the first."""
        for name, number in self._pixels.items():
            where = f"{number} pixels of {name}, first in {self._first[name]}"
            if CHANNELS[name].kind == "motion":
                yield f"unknown: {where}; they move as the camera turns or as their neighbours"
            else:
                yield f"bad: {where}: NaN, infinite or negative"
