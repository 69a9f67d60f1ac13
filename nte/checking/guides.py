"""Are albedo and normals free of noise and antialiased, as denoisers that trust their guides want them?

Two signs, both of single images. Antialiased, an edge between two flat regions has a pixel of neither colour, but for
the few that lie on the border of two pixels; aliased, or from one jittered sample, it has none. And where values are
drawn anew in every pixel, many are larger or smaller than both of their neighbours in all four directions; edges,
gradients and thin lines are so in three directions at the most.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from torch import Tensor

from nte.checking.values import Finding
from nte.frames.clip import Clip
from nte.frames.frame import Frame

GUIDES = ("albedo", "normal")
FRAMES = 4  # that are looked at, at the most
STRONG = 0.15  # step of albedo that counts as an edge
FLAT = 0.05  # of the step: how much the two regions may vary
PURE = 0.07  # of the step: a pixel this close to one side has its colour
ENOUGH = 200  # edges
ALIASED = 0.14  # share of pure edges; measured: 0 to 0.12 with 16 samples in a pixel, 0.15 to 0.94 with one
SMALL = 0.1  # differences up to this are of textures and noise, not of edges
NOISY = 0.03  # share of the squared differences in extremes, of albedo; measured: up to 0.022 without noise,
# 0.035 to 0.06 through a lens with one sample; of small differences 0.025 to 0.12 with noise of σ = 0.02
VISIBLE = 0.012  # root mean square of the small differences, below which noise does not matter
DIRECTIONS = ((0, 1), (1, 0), (1, 1), (1, -1))


@dataclass
class _Signs:
    """Sums over the images of one guide."""

    edges: int = 0
    pure: int = 0
    extreme: float = 0.0  # sum of squared differences that are extremes in all directions
    squares: float = 0.0  # of all
    small_extreme: float = 0.0  # the same where all differences around are small
    small_squares: float = 0.0
    small: int = 0  # values

    def add(self, image: Tensor) -> None:
        """Add an image (C, H, W)."""
        self._add_edges(image)
        self._add_edges(image.transpose(1, 2))
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

    def _add_edges(self, values: Tensor) -> None:
        width = values.shape[2] - 5
        if width < 1:
            return
        left, begin, first, second, end, right = (values[..., i : i + width] for i in range(6))

        def apart(a: Tensor, b: Tensor) -> Tensor:
            return (a - b).abs().amax(0)

        step = apart(begin, end)
        edge = (step > STRONG) & (apart(left, begin) < FLAT * step) & (apart(end, right) < FLAT * step)
        pure = [(apart(pixel, begin) < PURE * step) | (apart(pixel, end) < PURE * step) for pixel in (first, second)]
        self.edges += int(edge.sum())
        self.pure += int((edge & pure[0] & pure[1]).sum())


class GuideTally:
    """The signs of noise and aliasing in the first frames of a clip."""

    def __init__(self) -> None:
        self._signs: dict[str, _Signs] = {}
        self._frames = 0

    def add(self, frame: Frame) -> None:
        """Add a PyTorch frame of batch 1; only the first few count."""
        self._frames += 1
        for name in GUIDES if self._frames <= FRAMES else ():
            if name in frame:
                self._signs.setdefault(name, _Signs()).add(frame[name][0].nan_to_num(0, 0, 0).clamp(-2, 2))

    def judge(self) -> Iterator[Finding]:
        """What is worth telling of the guides; no fault: only denoisers that trust them suffer."""
        for name, signs in self._signs.items():
            # Normals are made unit again after averaging, so their edges need not show a value in between.
            if name == "albedo" and signs.edges >= ENOUGH and signs.pure > ALIASED * signs.edges:
                share = f"{signs.pure / signs.edges:.0%} of {signs.edges} edges have no pixel in between"
                yield Finding(name, f"aliased: {share}", "antialiased guides for denoisers that trust them", False)
            strong = name == "albedo" and signs.extreme > NOISY * signs.squares
            visible = signs.small_squares > VISIBLE**2 * max(signs.small, 1)
            if strong or (visible and signs.small_extreme > NOISY * signs.small_squares):
                found = f"noisy: {signs.extreme / signs.squares:.1%} of the differences between pixels are isolated extremes"
                yield Finding(name, found, "noise-free guides for denoisers that trust them", False)


def _shifted(image: Tensor, dy: int, dx: int) -> Tensor:
    height, width = image.shape[1:]
    return image[:, 1 + dy : height - 1 + dy, 1 + dx : width - 1 + dx]


def guides_are_clean(clip: Clip) -> bool:
    """Are the albedo and the normals of a clip antialiased and free of noise, as far as its first frames show?

    True as well where too few edges can be seen to know; false without any guide. Raises NteError for files that
    cannot be read.
    """
    names = [name for name in GUIDES if name in clip.channels]
    tally = GuideTally()
    for index in range(min(FRAMES, len(clip))):
        tally.add(clip.frame(index, names).torch())
    return bool(names) and not any(tally.judge())
