"""A check that albedo and normals are noise-free and antialiased, as denoisers that trust their guides need them.

It looks for two signs in single images. Edges: an antialiased silhouette between two flat colours has a pixel in
between, except where it runs along the border of two pixels; an aliased one, or one from a single jittered sample,
has none. Noise: where each pixel has its own random value, many are larger or smaller than both of their neighbours
in all four directions; edges, gradients and thin lines are so in three directions at most.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor

from nte.checking.sample import FRAMES, spread
from nte.checking.values import Finding
from nte.frames.channels import GUIDES
from nte.frames.clip import Clip
from nte.frames.frame import Frame

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

    def add(self, image: Tensor, borders: Tensor | None) -> None:
        """Add an image (C, H, W). borders: bool (2, H, W), a silhouette lies to the right of the pixel, or below it."""
        self._add_edges(image, None if borders is None else borders[0])
        self._add_edges(image.transpose(1, 2), None if borders is None else borders[1].T)
        if min(image.shape[1:]) < 3:
            return
        extremes, squares, steps = [], [], []
        for dy, dx in DIRECTIONS:
            before, after = (_shifted(image, sign * dy, sign * dx) for sign in (-1, 1))
            rise, fall = _shifted(image, 0, 0) - before, after - _shifted(image, 0, 0)
            extremes.append((-rise * fall).clamp(min=0))
            squares.append((rise.square() + fall.square()) / 2)
            steps.append(torch.maximum(rise.abs(), fall.abs()))
        extreme, square = torch.stack(extremes).amin(0), torch.stack(squares).mean(0)
        small = torch.stack(steps).amax(0) < SMALL
        self.extreme += float(extreme.sum())
        self.squares += float(square.sum())
        self.small_extreme += float(extreme[small].sum())
        self.small_squares += float(square[small].sum())
        self.small += int(small.sum())

    def _add_edges(self, values: Tensor, border: Tensor | None) -> None:
        width = values.shape[2] - 5
        if width < 1:
            return
        left, begin, first, second, end, right = (values[..., i : i + width] for i in range(6))

        def apart(a: Tensor, b: Tensor) -> Tensor:
            return (a - b).abs().amax(0)

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
        """Add a PyTorch frame of batch 1."""
        borders = _silhouettes(frame)
        self._limit = ALIASED_ANYWHERE if borders is None else ALIASED
        for name in GUIDES:
            if name in frame:
                self._signs.setdefault(name, _Signs()).add(frame[name][0].nan_to_num(0, 0, 0).clamp(-2, 2), borders)

    def judge(self) -> Iterator[Finding]:
        """Yield findings about aliased or noisy guides; none is a fault, as only denoisers that trust guides suffer."""
        for name, signs in self._signs.items():
            # Normals are normalised after averaging, so their edges need not show a value in between.
            if name == "albedo" and signs.edges >= ENOUGH and signs.pure > self._limit * signs.edges:
                share = f"{signs.pure / signs.edges:.0%} of {signs.edges} silhouettes have no pixel in between"
                yield Finding(name, f"aliased: {share}", "antialiased guides for denoisers that trust them", False)
            strong = name == "albedo" and signs.extreme > NOISY * signs.squares
            visible = signs.small_squares > VISIBLE**2 * max(signs.small, 1)
            if strong or (visible and signs.small_extreme > NOISY * signs.small_squares):
                share = f"{signs.extreme / signs.squares:.1%} of the differences between pixels are lone extremes"
                yield Finding(name, f"noisy: {share}", "noise-free guides for denoisers that trust them", False)


def _silhouettes(frame: Frame) -> Tensor | None:
    """Bool masks (2, H, W): another surface lies to the right of the pixel, or below it; None if unknown."""
    if "instance" in frame:
        differs = [frame["instance"].diff(dim=dim) != 0 for dim in (3, 2)]
    elif "depth" in frame:
        differs = [frame["depth"].clamp(min=1e-6).log().diff(dim=dim).abs() > math.log(ONE_SURFACE) for dim in (3, 2)]
    else:
        return None
    right, below = (F.pad(d[0, 0], pad) for d, pad in zip(differs, ((0, 1), (0, 0, 0, 1)), strict=True))
    return torch.stack([right, below])


def _shifted(image: Tensor, dy: int, dx: int) -> Tensor:
    height, width = image.shape[1:]
    return image[:, 1 + dy : height - 1 + dy, 1 + dx : width - 1 + dx]


def guides_are_clean(clip: Clip) -> bool:
    """Tell whether the albedo and normals of a clip are antialiased and noise-free, as far as four of its frames show.

    Also true if too few edges are visible to know; false if the clip has neither
    albedo nor normals. Raises NteError for files that cannot be read.
    """
    guides = [name for name in GUIDES if name in clip.channels]
    names = [*guides, *(name for name in ("instance", "depth") if name in clip.channels)]
    tally = GuideTally()
    for index in sorted(spread(FRAMES, 0, len(clip))) if guides else ():
        tally.add(clip.frame(index, names).torch())
    return bool(guides) and not any(tally.judge())
