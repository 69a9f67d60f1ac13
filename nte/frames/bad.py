"""Warnings about a sequence's input, each given once: bad pixels, and forward motion that is 0 everywhere."""

import warnings
from collections import Counter

from nte.frames.ahead import NEXT
from nte.frames.channels import CHANNELS
from nte.frames.frame import Frame
from nte.frames.usable import LONG, all_usable, usable

STILL_PX = 0.5  # a pixel with a longer vector moves
MOVING = 0.01  # the picture moves if more than this share of its pixels does


class BadPixelWarning(UserWarning):
    """Warning that some pixels were NaN, infinite, negative or absurd, and were sanitised."""


class ForwardMotionWarning(UserWarning):
    """Warning that `previous_forward_motion` is 0 everywhere although the picture moves."""


def count_bad(frame: Frame) -> dict[str, int]:
    """Count the bad pixels of each channel; only channels that have some are in the result.

    A pixel is bad if `nte.frames.usable` would replace it, with three exceptions: a reflectance or a scalar that is
    finite but above 1, a direction that is only longer than 1, and a NaN that has a meaning in its channel
    (`nan_means` in `nte.CHANNELS`). Channels outside that table are not looked at, nor those of the next frame, which
    has its turn.
    """
    counts: dict[str, int] = {}
    for name, values in frame.channels.items():
        row = CHANNELS.get(name)
        if row is None or name in NEXT or all_usable(row, values):
            continue
        # NaN differs from everything, even from itself. NumPy and PyTorch share these operators.
        bad = usable(row, values) != values
        if row.kind in ("reflectance", "scalar"):
            bad = bad & ~((values > 1) & (values < float("inf")))
        if row.kind == "direction":
            bad = bad & ~(abs(values) <= LONG)
        if row.nan_means:
            bad = bad & (values == values).all(1)[:, None]
        if number := int(bad.any(1).sum()):
            counts[name] = number
    return counts


def says_nothing_moved(frame: Frame) -> bool:
    """Tell whether `previous_forward_motion` is 0 everywhere while `motion` is not.

    It then holds zeros only because the true vectors were unknown. `motion` is not 0 if more than 1 % of its pixels
    have a vector longer than 0.5 px along an axis. False if the frame lacks one of the two channels.
    """
    forward, motion = frame.get("previous_forward_motion"), frame.get("motion")
    if forward is None or motion is None or bool((forward != 0).any()):
        return False
    moves = (abs(motion) > STILL_PX) & (abs(motion) < float("inf"))
    return bool(int(moves.any(1).sum()) > MOVING * frame.batch * frame.size[0] * frame.size[1])


class BadPixelReport:
    """Counter of a sequence's bad pixels that warns once of each kind of problem; `total` is per channel."""

    def __init__(self) -> None:
        self.total: Counter[str] = Counter()
        self._told = False

    def look(self, frame: Frame) -> None:
        """Count a frame's bad pixels.

        Warns with BadPixelWarning at the first frame that has some, and with ForwardMotionWarning at the first frame
        for which `says_nothing_moved` is true.
        """
        counts = count_bad(frame)
        if counts and not self.total:
            listed = ", ".join(f"{number} in {name}" for name, number in counts.items())
            warnings.warn(
                f"frame {frame.index}: bad pixels (non-finite, negative or absurd) are sanitised: {listed}",
                BadPixelWarning,
                stacklevel=3,
            )
        self.total.update(counts)
        if not self._told and says_nothing_moved(frame):
            self._told = True
            warnings.warn(
                f"frame {frame.index}: previous_forward_motion is 0 everywhere while motion is not, so disocclusions "
                "are found where there are none: expected NaN where it is unknown, or no such channel",
                ForwardMotionWarning,
                stacklevel=3,
            )
