"""Whether albedo and normals are noise-free and antialiased, as denoisers that trust their guides need them.

Two signs in single images tell. Edges: an antialiased silhouette between two flat colours has a pixel in
between, except where it runs along the border of two pixels; an aliased one, or one from a single jittered sample,
has none. Noise: where each pixel has its own random value, many are larger or smaller than both of their neighbours
in all four directions; edges, gradients and thin lines are so in three directions at most. Fine textures are so, too,
but the reference shows them: only what it does not show is noise.
"""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from nte.frames.channels import GUIDES
from nte.frames.clip import Clip, Pixels
from nte.frames.frame import Frame
from nte.frames.sample import FRAMES, spread
from nte.frames.usable import ABSOLUTE

STRONG = 0.15  # least step of albedo that counts as an edge
FLAT = 0.05  # greatest variation of the two sides of an edge, as a share of the step
PURE = 0.07  # a pixel this close to one side, as a share of the step, has that side's colour
ENOUGH = 40  # least number of edges that can tell
ALIASED = 0.2  # share of pure silhouettes; measured: 0.01 to 0.14 with 16 samples in a pixel, 0.25 to 0.99 with one
ALIASED_ANYWHERE = 0.3  # share of all pure edges, if silhouettes are unknown; textures' own edges are soft
ONE_SURFACE = 1.1  # greatest ratio of the depths of one surface; a silhouette has a greater one
SMALL = 0.1  # smaller differences come from textures and noise, not from edges
NOISY = 0.03  # share of the squared differences in extremes, of albedo; measured: up to 0.022 without noise,
# 0.035 to 0.06 through a lens with one sample; of small differences 0.025 to 0.12 with noise of σ = 0.02
VISIBLE = 0.012  # root mean square of the small differences below which noise does not matter
DIRECTIONS = ((0, 1), (1, 0), (1, 1), (1, -1))

Mask = npt.NDArray[np.bool_]


class Flaw(NamedTuple):
    """What a guide shows that denoisers which trust it suffer from."""

    channel: str
    found: str
    expected: str


@dataclass
class _Signs:
    """Sums over the images of one guide."""

    edges: int = 0
    pure: int = 0
    extreme: float = 0.0  # sum of squared differences that are extremes in all directions
    squares: float = 0.0  # sum of all squared differences
    small_extreme: float = 0.0  # the same two sums, where all differences around are small
    small_squares: float = 0.0
    small: int = 0  # number of values with only small differences around

    def add(self, image: Pixels, borders: Mask | None, light: Pixels | None = None) -> None:
        """Add an image (C, H, W).

        borders: bool (2, H, W), a silhouette lies to the right of the pixel, or below it. light: the reference
        (C, H, W) if the image is albedo, whose textures it shows.
        """
        self._add_edges(image, None if borders is None else borders[0])
        self._add_edges(image.swapaxes(1, 2), None if borders is None else borders[1].T)
        if min(image.shape[1:]) < 3:
            return
        extremes, squares, steps = [], [], []
        for dy, dx in DIRECTIONS:
            before, after = (_shifted(image, sign * dy, sign * dx) for sign in (-1, 1))
            rise, fall = _shifted(image, 0, 0) - before, after - _shifted(image, 0, 0)
            extremes.append(np.maximum(-rise * fall, 0))
            squares.append((rise**2 + fall**2) / 2)
            steps.append(np.maximum(np.abs(rise), np.abs(fall)))
        extreme, square = np.min(extremes, 0), np.mean(squares, 0)
        small = np.max(steps, 0) < SMALL
        if light is not None:
            extreme *= 1 - _shown(image, light, extreme > 0)
        self.extreme += float(extreme.sum())
        self.squares += float(square.sum())
        self.small_extreme += float(extreme[small].sum())
        self.small_squares += float(square[small].sum())
        self.small += int(small.sum())

    def _add_edges(self, values: Pixels, border: Mask | None) -> None:
        width = values.shape[2] - 5
        if width < 1:
            return
        left, begin, first, second, end, right = (values[..., i : i + width] for i in range(6))

        def apart(a: Pixels, b: Pixels) -> Pixels:
            found: Pixels = np.abs(a - b).max(0)
            return found

        step = apart(begin, end)
        edge = (step > STRONG) & (apart(left, begin) < FLAT * step) & (apart(end, right) < FLAT * step)
        if border is not None:
            edge &= border[:, 2 : 2 + width]
        self.edges += int(edge.sum())
        self.pure += int((edge & (apart(first, begin) < PURE * step) & (apart(second, end) < PURE * step)).sum())


class GuideTally:
    """Tally of the signs of noise and aliasing in some frames of a clip."""

    def __init__(self) -> None:
        self._signs: dict[str, _Signs] = {}
        self._limit = ALIASED

    def add(self, frame: Frame) -> None:
        """Add a NumPy frame of batch 1."""
        borders = _silhouettes(frame)
        self._limit = ALIASED_ANYWHERE if borders is None else ALIASED
        for name in GUIDES:
            if name in frame:
                values = np.nan_to_num(frame[name][0].astype(np.float32), nan=0, posinf=0, neginf=0)
                light = frame["reference"][0] if name == "albedo" and "reference" in frame else None
                self._signs.setdefault(name, _Signs()).add(values.clip(-2, 2), borders, light)

    def flaws(self) -> Iterator[Flaw]:
        """Yield what shows that guides are aliased or noisy."""
        for name, signs in self._signs.items():
            # Normals are normalised after averaging, so their edges need not show a value in between.
            if name == "albedo" and signs.edges >= ENOUGH and signs.pure > self._limit * signs.edges:
                share = f"{signs.pure / signs.edges:.0%} of {signs.edges} silhouettes have no pixel in between"
                yield Flaw(name, f"aliased: {share}", "antialiased guides for denoisers that trust them")
            strong = name == "albedo" and signs.extreme > NOISY * signs.squares
            visible = signs.small_squares > VISIBLE**2 * max(signs.small, 1)
            if strong or (visible and signs.small_extreme > NOISY * signs.small_squares):
                share = f"{signs.extreme / signs.squares:.1%} of the differences between pixels are lone extremes"
                yield Flaw(name, f"noisy: {share}", "noise-free guides for denoisers that trust them")


def _shown(image: Pixels, light: Pixels, where: Mask) -> float:
    """Share in [0, 1] of the lone extremes of albedo (C, H, W), marked in `where` (C, H − 2, W − 2), that light shows.

    A texture differs from what is around it as much as its light does, in shares of both; noise is not in the light.
    """
    ours, theirs = (_detail(values)[where] for values in (image, light))
    known = np.isfinite(ours) & np.isfinite(theirs)
    squares = float(np.square(ours[known]).sum())
    return min(max(float((ours * theirs)[known].sum()) / squares, 0.0), 1.0) if squares > 0 else 0.0


def _detail(values: Pixels) -> Pixels:
    """Compute what values (C, H, W) differ by from those around, in shares of both: (C, H − 2, W − 2)."""
    values = np.where((values > 0) & (values < ABSOLUTE), values, np.nan).astype(np.float32)
    around = sum(_shifted(values, sign * dy, sign * dx) for dy, dx in DIRECTIONS for sign in (-1, 1)) / 8
    centre = _shifted(values, 0, 0)
    detail: Pixels = (centre - around) / (centre + around)
    return detail


def _silhouettes(frame: Frame) -> Mask | None:
    """Bool masks (2, H, W): another surface lies to the right of the pixel, or below it; None if unknown."""
    if "instance" in frame:
        differs = [np.diff(frame["instance"][0, 0], axis=axis) != 0 for axis in (1, 0)]
    elif "depth" in frame:
        with np.errstate(invalid="ignore"):
            logarithm = np.log(np.maximum(frame["depth"][0, 0].astype(np.float32), 1e-6))
            differs = [np.abs(np.diff(logarithm, axis=axis)) > math.log(ONE_SURFACE) for axis in (1, 0)]
    else:
        return None
    return np.stack([np.pad(d, pad) for d, pad in zip(differs, (((0, 0), (0, 1)), ((0, 1), (0, 0))), strict=True)])


def _shifted(image: Pixels, dy: int, dx: int) -> Pixels:
    height, width = image.shape[1:]
    return image[:, 1 + dy : height - 1 + dy, 1 + dx : width - 1 + dx]


def are_clean(frames: Iterable[Frame]) -> bool | None:
    """Tell whether the albedo and normals of frames are antialiased and noise-free, as far as the pixels show.

    Also true if too few edges are visible to know; None if there are neither albedo nor normals.
    """
    tally, guided = GuideTally(), False
    for frame in frames:
        tally.add(frame.numpy())
        guided |= any(name in frame for name in GUIDES)
    return not any(tally.flaws()) if guided else None


def guides_are_clean(clip: Clip) -> bool:
    """Tell whether the albedo and normals of a clip are antialiased and noise-free, as four of its frames show.

    Also true if too few edges are visible to know; false if the clip has neither albedo nor normals. Raises NteError
    for files that cannot be read.
    """
    names = [name for name in (*GUIDES, "instance", "depth", "reference") if name in clip.channels]
    guided = any(name in GUIDES for name in names)
    return guided and bool(are_clean(clip.frame(index, names) for index in sorted(spread(FRAMES, 0, len(clip)))))
