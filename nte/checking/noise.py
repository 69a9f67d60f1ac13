"""A check that every pixel of every frame has noise of its own: only then do more of them have less of it.

An image that is exactly that of the frame before brings nothing new; a reference that is was held, if surfaces move.
Where there is a reference, noise is what colour has beside it, in shares of both, without the mean around each pixel. A
denoiser, a wide pixel filter and upscaling give neighbours the same noise; a seed that stays gives it to each pixel
again; and what an engine accumulates over frames moves with its surface.
"""

from collections import defaultdict
from collections.abc import Iterator

import torch
import torch.nn.functional as F
from torch import Tensor

from nte.checking.late import correlate
from nte.checking.values import Finding
from nte.frames.frame import Frame
from nte.motion.geometric import traditional_motion
from nte.motion.warp import fetch_nearest, pixel_centres

AROUND = 7  # pixels: side of the square whose mean is no noise
SIGMAS = 5.0  # least correlation, in standard deviations of images that have nothing in common
SHARED = 0.15  # least correlation that is told; measured: −0.05 to 0.06 in right clips, 0.2 to 1 with shared noise
LEAST = 0.02  # least root mean square of the noise, in shares of the light: less is the difference of two renders
MOVING_PX = 0.5  # pixels: mean length of the vectors of a frame in which much moves
NEIGHBOURS, BEFORE, ALONG = (
    "neighbouring pixels",
    "the same pixel of the frame before",
    "its surface in the frame before",
)


class NoiseTally:
    """Tally of frames whose noisy image is that of the frame before, and of what noise they share."""

    def __init__(self) -> None:
        self._repeated: list[int] = []
        self._held: list[int] = []  # frames whose reference is that of the frame before, though motion is not 0
        self._frames = 0
        self._shared: dict[str, list[float]] = defaultdict(list)  # who shares it → correlations
        self._squares: list[float] = []
        self._pixels = 0  # of all frames that are compared

    def add(self, previous: Frame, current: Frame, look: bool = True) -> None:
        """Add two consecutive PyTorch frames of batch 1. look: compare their noise as well, which costs more."""
        if "color" not in current or "color" not in previous:
            return
        self._frames += 1
        if "reference" in current and "reference" in previous and "motion" in current:
            length = current["motion"].nan_to_num(0, 0, 0).norm(dim=1)[0]
            moving = current["reference"][0][:, length > MOVING_PX]
            seen = bool((moving != moving[:, :1]).any())  # in the dark, or in an even light, nothing is
            same = bool((current["reference"] == previous["reference"]).all())
            if float(length.mean()) > MOVING_PX and seen and same:
                self._held.append(current.index)
        if bool(current["color"].any()) and bool((current["color"] == previous["color"]).all()):
            self._repeated.append(current.index)
        elif look and "reference" in current and "reference" in previous:
            before, now = _noise(previous), _noise(current)
            self._pixels += now.numel()
            self._squares.append(float(now.square().mean()))
            beside = correlate(now[..., 1:], now[..., :-1]), correlate(now[..., 1:, :], now[..., :-1, :])
            self._shared[NEIGHBOURS].append(sum(beside) / 2)
            self._shared[BEFORE].append(correlate(before, now))
            if "motion" in current:
                vectors = traditional_motion(current["motion"])
                fetched = fetch_nearest(before, pixel_centres(now) + vectors.motion)
                self._shared[ALONG].append(correlate(fetched * vectors.valid, now))

    def judge(self, known: bool = True) -> Iterator[Finding]:
        """Yield a note for repeated images, a doubt for those of the reference, and a note for noise that is shared.

        A picture without noise that stands still repeats itself, too. known: the reference is that of these frames.
        """
        if self._repeated:
            where = f"in {len(self._repeated)} of {self._frames} frames, the first is {self._repeated[0]}"
            found = f"is the same image as in the frame before {where}"
            yield Finding("color", found, "new noise in each frame", False)
        if self._held:
            where = f"in {len(self._held)} of {self._frames} frames, the first is {self._held[0]}"
            found = f"is the same image as in the frame before {where}, though motion is not 0 there"
            yield Finding("reference", found, "a reference of its own for each frame", False, True)
        if not known or not self._squares or sum(self._squares) < LEAST**2 * len(self._squares):
            return
        shared = {who: sum(found) / len(found) for who, found in self._shared.items()}
        least = max(SHARED, SIGMAS / self._pixels**0.5)
        if told := [f"{who} ({share:.2f})" for who, share in shared.items() if share > least]:
            expected = "noise of its own in each pixel and frame: not denoised, upscaled, accumulated, or of one seed"
            yield Finding("color", f"shares its noise with {', '.join(told)}: correlation", expected, False)


def _noise(frame: Frame) -> Tensor:
    """Compute the noise (1, 1, H, W) of a frame in shares of its light; 0 where it is unknown."""
    color, reference = (frame[name].mean(1, keepdim=True) for name in ("color", "reference"))
    known = color.isfinite() & reference.isfinite() & (color >= 0) & (reference > 0)
    share = torch.where(known, (color - reference) / (color + reference), 0.0)
    side = min(AROUND, 2 * ((min(frame.size) + 1) // 2) - 1)
    mean, seen = (F.avg_pool2d(values, side, 1, side // 2) for values in (share, known.float()))
    return torch.where(known, share - mean / seen.clamp(min=1e-6), 0.0)
