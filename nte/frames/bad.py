"""Looking for what users want to hear of, once: bad pixels, and vectors that say nothing."""

import warnings
from collections import Counter

from nte.frames.channels import CHANNELS
from nte.frames.frame import Frame
from nte.frames.usable import LONG, all_usable, usable

STILL_PX = 0.5  # vectors that are longer say that something moves
MOVING = 0.01  # share of the pixels with such vectors at which the picture moves


class BadPixelWarning(UserWarning):
    """Some pixels were NaN, infinite, negative or absurd, and were sanitised."""


class ForwardMotionWarning(UserWarning):
    """`previous_forward_motion` is 0 everywhere although the picture moves."""


def count_bad(frame: Frame) -> dict[str, int]:
    """Number of bad pixels per channel, only channels that have some.

    Bad is what `nte.frames.usable` replaces, but for a share that is merely above 1 and a vector of another length.
    A NaN that says something in its channel (see CHANNELS) is not bad.
    """
    counts: dict[str, int] = {}
    for name, values in frame.channels.items():
        row = CHANNELS.get(name)
        if row is None or all_usable(row, values):
            continue
        # NaN differs from everything, itself too; written with operators that NumPy and PyTorch share.
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
    """Whether `previous_forward_motion` is 0 everywhere while `motion` is not: nobody knew it, and gave zeros."""
    forward, motion = frame.get("previous_forward_motion"), frame.get("motion")
    if forward is None or motion is None or bool((forward != 0).any()):
        return False
    moves = (abs(motion) > STILL_PX) & (abs(motion) < float("inf"))
    return bool(int(moves.any(1).sum()) > MOVING * frame.batch * frame.size[0] * frame.size[1])


class BadPixelReport:
    """Counts the bad pixels of a sequence, and warns once of each kind of thing that is met."""

    def __init__(self) -> None:
        self.total: Counter[str] = Counter()
        self._told = False

    def look(self, frame: Frame) -> None:
        """Add a frame; warns if it is the first one with bad pixels, or with forward motion that says nothing."""
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
