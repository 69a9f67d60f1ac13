"""A check that all channels show the same place of the picture: a crop that is ignored, or another eye, moves one.

The edges of a channel are correlated with those of the light at every displacement, as in `nte.checking.flips`. Where
it is right, the peak is at no displacement, or beside it. A peak that is as sharp, and twice as high, elsewhere shows
where the channel lies. But the shadow of what floats is its outline at another place, and depth, ids and
roughness show only outlines: of these it is a doubt.
"""

from collections.abc import Iterator

import torch
from torch import Tensor

from nte.checking.flips import BETTER, OUTLINES, PICTURES, SHARP, block_of, correlation, edges_of, height_at
from nte.checking.values import Finding
from nte.frames.frame import Frame

LEAST_BLOCKS = 2  # blocks of pixels: shading moves the edges of right channels by one
SAME_PLACE = "the same place in every channel, with the data window, the overscan and the eye of the light"


class DisplacedTally:
    """Tally of the correlations between the edges of light and channels, in some frames of a clip."""

    def __init__(self) -> None:
        self._matches: dict[str, Tensor] = {}  # channel → sum of correlations, by displacement
        self._block = 1
        self._light = ""

    def add(self, frame: Frame) -> None:
        """Add a PyTorch frame of batch 1."""
        self._block = block_of(frame.size)
        self._light = "reference" if "reference" in frame else "color"
        seen = edges_of(frame, dict.fromkeys(("color", self._light, *PICTURES)))
        for name in (name for name in ("reference", *PICTURES) if name in seen):
            match = correlation(seen["color" if name == "reference" else self._light], seen[name])
            self._matches[name] = self._matches.get(name, torch.zeros(())) + match

    def judge(self) -> Iterator[Finding]:
        """Yield a fault for a reference that lies beside color, else for each guide that lies beside the light.

        A doubt for what shows only outlines.
        """
        for name, match in self._matches.items():
            place = _place(match)
            least = max(SHARP, BETTER * height_at(match))
            if max(map(abs, place)) >= LEAST_BLOCKS and height_at(match, place) >= least:
                right, down = (self._block * step for step in place)
                beside = f"{_way(right, 'to the right', 'to the left')} and {_way(down, 'below', 'above')}"
                light = "color" if name == "reference" else self._light
                outlines = name in OUTLINES
                what = f"shows what {light} shows about {beside}{'; or shadows lie there' if outlines else ''}"
                yield Finding(name, what, SAME_PLACE, not outlines, outlines)
                if name == "reference":
                    return


def _place(match: Tensor) -> tuple[int, int]:
    """Displacement (x, y) at which a cyclic correlation (h, w) is greatest, in blocks."""
    row, column = divmod(int(match.argmax()), match.shape[1])
    y, x = (at - size if at > size // 2 else at for at, size in zip((row, column), match.shape, strict=True))
    return x, y


def _way(pixels: int, forward: str, back: str) -> str:
    return f"{abs(pixels)} px {forward if pixels > 0 else back}"
