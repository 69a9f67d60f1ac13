"""A check that guides show the picture the same way up as the light: their edges must lie where its edges lie.

The edges of a guide are correlated with those of the reference, or else of the colour, at every displacement of the
two pictures. Where a guide is right, the correlation has its peak at no displacement. If the guide is the right way up
only after it has been turned over, the peak is there instead: so sharp a peak at just that place is no coincidence.
"""

from collections.abc import Iterable, Iterator

import torch
from torch import Tensor

from nte.checking.edges import edges, picture
from nte.checking.values import Finding
from nte.frames.channels import GUIDES
from nte.frames.frame import Frame

FLIPS = {"upside down": (-2,), "mirrored left to right": (-1,), "turned by 180°": (-2, -1)}  # in words → dimensions
AS_IT_IS = ""
ORIENTATION = "the same orientation in every channel"
OUTLINES = ("depth", "instance", "roughness")  # channels that show where surfaces end, and hardly any texture
PICTURES = (*GUIDES, *OUTLINES, "diffuse_albedo", "geometric_normal")  # channels that show the surfaces
BLOCKS = 64  # about so many blocks of pixels, of 2×2 or more, along the shorter side: their means have less noise
LEAST = 12  # blocks along a side; smaller pictures tell nothing
SHARP = (
    6.0  # least height of the peak in standard deviations: `python -m benchmarks.check --turned` says how many reach it
)
BETTER = 2.0  # the peak of a guide that is turned over is at least this many times what it is as it is


class FlipTally:
    """Tally of the correlations between the edges of light and guides, in some frames of a clip."""

    def __init__(self) -> None:
        self._matches: dict[tuple[str, str], Tensor] = {}  # guide and flip → sum of correlations, by displacement
        self._light = ""

    def add(self, frame: Frame) -> None:
        """Add a PyTorch frame of batch 1."""
        self._light = "reference" if "reference" in frame else "color"
        seen = edges_of(frame, (self._light, *PICTURES))
        for name in (name for name in PICTURES if name in seen):
            for how, sides in {AS_IT_IS: (), **FLIPS}.items():
                match = correlation(seen[self._light], seen[name].flip(sides))
                self._matches[name, how] = self._matches.get((name, how), torch.zeros(())) + match

    def judge(self) -> Iterator[Finding]:
        """Yield a fault for each guide whose edges lie where those of the light are only after it is turned over."""
        for name in dict.fromkeys(name for name, _ in self._matches):
            least = max(SHARP, BETTER * height_at(self._matches[name, AS_IT_IS]))
            peaks = {how: height_at(match) for how in FLIPS if (match := self._matches[name, how]).argmax() == 0}
            if peaks and max(peaks.values()) >= least:
                how = max(peaks, key=lambda how: peaks[how])
                yield Finding(name, f"shows the picture of {self._light} {how}", ORIENTATION)


def edges_of(frame: Frame, names: Iterable[str]) -> dict[str, Tensor]:
    """Measure the edges (h, w) of the channels that a PyTorch frame of batch 1 has; of none if it is too small."""
    size = frame.size[0] // block_of(frame.size), frame.size[1] // block_of(frame.size)
    if min(size) < LEAST:
        return {}
    return {name: edges(picture(frame, name, size)) for name in names if name in frame}


def block_of(size: tuple[int, int]) -> int:
    """Return the side of the blocks, in pixels, to which pictures of `size` are reduced."""
    return max(2, round(min(size) / BLOCKS))


def correlation(a: Tensor, b: Tensor) -> Tensor:
    """Correlate two images (h, w) at every cyclic displacement (h, w); 0 if one of them is constant.

    At (y, x), a is as far below and to the right of b.
    """
    a, b = a - a.mean(), b - b.mean()
    product: Tensor = torch.fft.irfft2(torch.fft.rfft2(a) * torch.fft.rfft2(b).conj(), s=a.shape)
    sizes: Tensor = a.norm() * b.norm()
    return product / sizes.clamp(min=1e-30)


def height_at(match: Tensor, place: tuple[int, int] = (0, 0)) -> float:
    """Measure how far a correlation at displacement `place` (x, y) lies above its mean, in standard deviations."""
    return float((match[place[1], place[0]] - match.mean()) / match.std().clamp(min=1e-12))
