"""Notes for the user about the values of an imported sequence."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from nte.frames.channels import CHANNELS, VECTORS
from nte.frames.clip import Pixels
from nte.frames.exr import REC_709, Part
from nte.importing.channel_map import NORMALS, ChannelMap
from nte.importing.convert import LEAST_NORMAL, decoded

_OURS = ("", "lin_rec709_scene", "data", "unknown")  # colour spaces of which there is nothing to tell
_SQUARE = 1e-3  # greatest distance from 1 of an aspect of square pixels
_CUT = -0.1, 1.1  # albedo beyond this range has another scale
_OF_TWO = 2.1  # the same, where a specular and a transmitted colour are added
_UNIT = 0.05  # greatest distance from 1 of the median length of normals that is not worth a word
_COARSE = 0.1  # px: vectors in steps above this are worth a word
_MANY = 0.01  # share of the pixels beyond that range from which on the user is told


class LeftInFiles:
    """Record of what is not kept of files: subsampled channels, overscan, values and colours, pixels' shapes."""

    def __init__(self) -> None:
        self._subsampled: set[str] = set()
        self._overscan = False
        self._lossy: set[str] = set()
        self._primaries: set[tuple[float, ...]] = set()
        self._spaces: set[str] = set()
        self._aspects: set[float] = set()

    def look(self, parts: Sequence[Part]) -> None:
        """Add the parts of a file."""
        self._subsampled |= {part.full(name) for part in parts for name in part.subsampled}
        self._overscan |= any(part.overscan for part in parts)
        self._lossy |= {part.lossy for part in parts if part.lossy}
        self._primaries |= {part.primaries for part in parts if not np.allclose(part.primaries, REC_709, atol=1e-3)}
        self._spaces |= {part.space for part in parts if part.space not in _OURS}
        self._aspects |= {part.aspect for part in parts if abs(part.aspect - 1) > _SQUARE}

    def notes(self) -> Iterator[str]:
        """Write a line for each of them."""
        if self._subsampled:
            yield f"left out: {', '.join(sorted(self._subsampled))}: subsampled, without a value for every pixel"
        if self._overscan:
            yield "left out: overscan, the pixels outside the display window: nte denoise leaves them noisy"
        if self._lossy:
            yield f"lossy: {', '.join(sorted(self._lossy))} compression changes vectors, normals and ids too: write ZIP"
        for primaries in sorted(self._primaries):
            shown = " ".join(f"{number:.4g}" for number in primaries)
            yield f"not converted: colours have the primaries {shown}, and are shown as if they were those of Rec. 709"
        for space in sorted(self._spaces):
            yield f"not converted: the files call their colours {space}, which are shown as if they were {_OURS[1]}"
        for aspect in sorted(self._aspects):
            yield f"not square: pixels are {aspect:.4g} times as wide as high; filters and pictures take them as square"


class OddValues:
    """Counter of unusable pixels, frame by frame: NaN or infinite values, negative radiance, unknown (NaN) vectors."""

    def __init__(self) -> None:
        self._pixels: Counter[str] = Counter()
        self._first: dict[str, Path] = {}

    def look(self, channels: Mapping[str, Pixels], files: Mapping[str, Path]) -> None:
        """Add a frame of channels (C, H, W). files: channel → the file that it was read from."""
        for name, values in channels.items():
            usable = np.isfinite(values) | (np.isnan(values) & bool(CHANNELS[name].nan_means))
            if CHANNELS[name].kind in ("radiance", "reflectance"):
                usable &= values >= 0
            if odd := int((~usable).any(0).sum()):
                self._pixels[name] += odd
                self._first.setdefault(name, files[name])

    def notes(self) -> Iterator[str]:
        """Write a line for each channel that has unusable pixels, naming the first file with some."""
        for name, number in self._pixels.items():
            where = f"{number} pixels of {name}, first in {self._first[name]}"
            if name in VECTORS:
                yield f"unknown: {where}; they move as the camera turns or as their neighbours"
            else:
                yield f"bad: {where}: NaN, infinite or negative"


class LostValues:
    """Record of values that are lost because a map is wrong: albedo of another scale, depth of another sign.

    how: the map, with completed channels.
    """

    def __init__(self, how: ChannelMap) -> None:
        albedo = how.channels.get("albedo")
        self._most = _OF_TWO if albedo and (albedo.plus or albedo.where_dark) else _CUT[1]
        self._encoded = how.normal.encoded
        self._pixels = self._cut = self._hits = self._missed = 0
        self._albedo, self._depth, self._missed_depth = Range(), Range(), Range()
        self._normals = {name: _StoredNormals() for name in NORMALS}

    def look(self, stored: Mapping[str, Pixels], ours: Mapping[str, Pixels]) -> None:
        """Add a frame of channels (C, H, W), before and after conversion; depths of the sky are infinite."""
        self._pixels += stored["color"][0].size
        if "albedo" in stored:
            values = stored["albedo"]
            self._albedo.add(values)
            self._cut += int(((values < _CUT[0]) | (values > self._most)).any(0).sum())
        for name in (name for name in NORMALS if name in stored):
            self._normals[name].add(stored[name], self._decoded(stored[name]))
        if "depth" in stored:
            depth, hit = stored["depth"], ours["depth"][0] > 0
            self._depth.add(depth[np.abs(depth) > 0])
            self._hits += int(hit.sum())
            missed = self._shown(stored) & ~hit
            self._missed += int(missed.sum())
            self._missed_depth.add(depth[0][missed])

    def _decoded(self, normal: Pixels) -> Pixels:
        return decoded(normal) if self._encoded else normal

    def _shown(self, stored: Mapping[str, Pixels]) -> npt.NDArray[np.bool_]:
        """Mark the pixels (H, W) in which normals or instances show a surface; without both, positions."""
        shown = np.zeros(stored["depth"].shape[1:], np.bool_)
        if "normal" in stored:
            shown |= (np.abs(self._decoded(stored["normal"])) > LEAST_NORMAL).any(0)
        if "instance" in stored:
            shown |= stored["instance"][0] != 0
        if "position" in stored and not {"normal", "instance"} & set(stored):
            shown |= np.isfinite(stored["position"]).all(0) & stored["position"].any(0)
        return shown

    def notes(self) -> Iterator[str]:
        """Write a line for albedo that is cut, for normals that are not encoded or not unit, and for lost surfaces.

        Each if it is so in over 1 % of the pixels.
        """
        if self._cut > _MANY * self._pixels:
            share = f"{self._cut / self._pixels:.0%} of the pixels of albedo, which is stored as {self._albedo}"
            yield f"cut to [0, 1]: {share}: if that is another scale, say it with channels.albedo.scale"
        for name, seen in self._normals.items():
            if self._encoded and seen.negative > _MANY * self._pixels:
                stored = f"{name}, which is stored as {seen.range}"
                yield f"decoded: {stored}: n/2 + 1/2 is never negative, see normal.encoded"
            length = np.median(seen.lengths or [1.0])
            if abs(length - 1) > _UNIT:
                yield f"normalised: {name}, whose vectors are about {length:.3g} long: is it that layer?"
        hint = "see depth.scale, negative where depth counts downwards, and depth.sky"
        if self._depth.known and not self._hits:
            yield f"no pixel shows a surface: depth is stored as {self._depth}: {hint}"
        elif self._missed > _MANY * self._pixels:
            stored = (
                f"stored as {self._missed_depth}" if self._missed_depth.known else "not finite, or beyond depth.sky"
            )
            share = f"{self._missed / self._pixels:.0%} of the pixels, whose other channels show a surface"
            yield f"made misses: {share}: their depth is {stored}: {hint}"


class _StoredNormals:
    """What is known of normals: their range as they are stored, how many are negative, and how long they are."""

    def __init__(self) -> None:
        self.range = Range()
        self.negative = 0  # pixels with a negative component
        self.lengths: list[float] = []  # medians over the normals of each frame

    def add(self, stored: Pixels, normal: Pixels) -> None:
        """Add a frame of normals (3, H, W), as they are stored and decoded."""
        self.range.add(stored)
        self.negative += int((stored < _CUT[0]).any(0).sum())
        lengths = np.linalg.norm(normal, axis=0)
        if (some := lengths[np.isfinite(lengths) & (lengths > 0)]).size:
            self.lengths.append(float(np.median(some)))


class CoarseVectors:
    """Record of vectors and positions in coarse steps: half floats around 0.5 are 1 px of a full HD image apart."""

    def __init__(self) -> None:
        self._steps: dict[str, float] = {}
        self._position = 0.0

    def look(self, name: str, step: float) -> None:
        """Add a channel of vectors of a frame, whose values are `step` pixels apart."""
        self._steps[name] = max(step, self._steps.get(name, 0.0))

    def look_at_positions(self, step: float) -> None:
        """Add the positions of a frame, whose values are `step` scene units apart; 0 if they are no half floats."""
        self._position = max(step, self._position)

    def notes(self) -> Iterator[str]:
        """Write a line for positions in half floats, and for each channel with steps above a tenth of a pixel."""
        if self._position:
            steps = f"in steps of {self._position:.2g} scene units"
            yield f"coarse: position is stored in half floats, {steps}; cameras come from it: write 32-bit floats"
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
