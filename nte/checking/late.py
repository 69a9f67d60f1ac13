"""A check that all channels show the same frame: engines may write some of them one frame late.

The light of a frame is correlated with a channel of the same frame, of the frame before and of the next one: as a
picture with the reference, and by their edges with guides. Where anything moves, the correlation is greatest in the
same frame, whatever else the light shows. The loss in another frame is known, because the channel itself tells how much
it changes: relative to that, a channel scores −1 if it is right, and +1 if it is late. Guides are compared with the
reference only: noise hides their edges so far that a right albedo, of a moving fence, has scored as late.
"""

from collections import defaultdict
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from nte.checking.edges import edges, picture
from nte.checking.flips import PICTURES, correlation
from nte.checking.values import Finding
from nte.frames.frame import Frame

SHOWN = (*PICTURES, "position")  # channels that show the surfaces
FINEST = 256  # blocks of pixels along the shorter side, about; images with fewer pixels are not reduced
SMALLEST = 12  # pixels: smaller pictures tell nothing
ENOUGH = 3  # least number of pairs of frames
SCORE = 0.5  # least score of a channel that is late; motion blur of a whole frame brings one that is right to 0
SIGMAS = 5.0  # least gain in the correlation, in standard deviations of images that have nothing in common
AGREE = 0.7  # the gains of the pairs add up to at least this share of their sizes
SAME_FRAME = "the same frame in every channel"


class Match(NamedTuple):
    """Correlations of light and a channel in two consecutive frames, and of the channel with itself."""

    same: float  # light and channel in the same frame, mean of both frames
    fading: float  # how much the first frame exceeds that mean: what light that fades gains in the frame before
    late: float  # the light of the first frame and the channel of the second
    early: float  # the light of the second frame and the channel of the first
    itself: float  # the channel of the first frame and that of the second
    beside: Tensor | None  # (h, w), at every displacement in the same frame, mean of both; None if others match less
    pixels: int


class LateTally:
    """Tally of the correlations between light and channels in the same frame and in neighbouring ones."""

    def __init__(self) -> None:
        self._of_reference: list[Match] = []
        self._of_guides: dict[str, list[Match]] = defaultdict(list)

    def add(self, previous: Frame, current: Frame) -> None:
        """Add two consecutive PyTorch frames of batch 1; those without reference tell nothing."""
        block = max(1, round(min(current.size) / FINEST))
        size = current.size[0] // block, current.size[1] // block
        pair = previous, current
        if min(size) < SMALLEST or "reference" not in current:
            return
        color, reference = ([picture(f, name, size)[0, 0] for f in pair] for name in ("color", "reference"))
        self._of_reference.append(_match(color, reference))
        light = [edges(picture(f, "reference", size)) for f in pair]
        for name in (name for name in SHOWN if name in current):
            self._of_guides[name].append(_match(light, [edges(picture(f, name, size)) for f in pair]))

    def judge(self, displaced: bool = False) -> Iterator[Finding]:
        """Yield a fault for a reference that shows a neighbouring frame of colour, else for each guide that does.

        A guide does not if it matches the same frame better at another place. displaced: the reference may do so, too.
        """
        if when := _shows(self._of_reference, displaced):
            yield Finding("reference", f"shows what color shows {when}", SAME_FRAME)
            return
        for name, matches in self._of_guides.items():
            if when := _shows(matches, True):
                yield Finding(name, f"shows what reference shows {when}", SAME_FRAME)


def _match(light: Sequence[Tensor], channel: Sequence[Tensor]) -> Match:
    (first, second), (before, now) = light, channel
    each = correlate(first, before), correlate(second, now)
    same, fading = (each[0] + each[1]) / 2, (each[0] - each[1]) / 2
    late, early = correlate(first, now), correlate(second, before)
    beside = (correlation(first, before) + correlation(second, now)) / 2 if max(late, early) > same else None
    return Match(same, fading, late, early, correlate(before, now), beside, now.numel())


def _shows(matches: Sequence[Match], displaced: bool) -> str:
    """Say in words which neighbouring frame of the light a channel shows; "" if it shows the same one, or unknown.

    displaced: it does not if it matches the same frame better at another place.
    """
    if len(matches) < ENOUGH:
        return ""
    least = SIGMAS * (len(matches) / matches[0].pixels) ** 0.5
    fading = abs(sum(m.fading for m in matches))  # light that fades, or becomes noisy, matches all frames less and less
    gain = [m for m in matches if m.beside is not None] if displaced else []
    beside = float(torch.stack([m.beside for m in gain if m.beside is not None]).sum(0).max()) if gain else 0.0
    found = {}
    for when, other in (("one frame earlier", "late"), ("one frame later", "early")):
        gains = [getattr(m, other) - m.same for m in matches]
        expected = sum((1 - m.itself) * max(m.same, getattr(m, other), 0.0) for m in matches)
        if sum(getattr(m, other) for m in gain) < beside:
            continue
        if sum(gains) - fading > max(least, SCORE * expected, AGREE * sum(map(abs, gains))):
            found[when] = sum(gains)
    return max(found, key=lambda when: found[when], default="")


def correlate(a: Tensor, b: Tensor) -> float:
    """Correlate two images of one shape; 0 if one of them is constant."""
    a, b = a - a.mean(), b - b.mean()
    return float((a * b).sum() / (a.norm() * b.norm()).clamp(min=1e-30))
