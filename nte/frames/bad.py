"""Counting bad pixels: values that denoisers sanitise and that users want to hear of, once."""

import warnings
from collections import Counter

from nte.frames.channels import CHANNELS
from nte.frames.frame import Frame


class BadPixelWarning(UserWarning):
    """Some pixels were NaN, infinite, negative or absurd, and were sanitised."""


def count_bad(frame: Frame) -> dict[str, int]:
    """Number of bad pixels per channel, only channels that have some.

    Bad is: a non-finite value; a negative radiance or reflectance; a motion longer than four images.
    A NaN that says something in its channel (see CHANNELS) is not bad.
    """
    counts: dict[str, int] = {}
    limit = 4.0 * max(frame.size)
    for name, values in frame.channels.items():
        row = CHANNELS.get(name)
        if row is None:
            continue
        # NaN fails every comparison; written with operators that NumPy and PyTorch share.
        # A shadow or a reflection, which are noisy, may really have been that far away.
        longest = limit if row.kind == "motion" and not row.noisy else float("inf")
        bad = ~(abs(values) < longest)
        if row.kind in ("radiance", "reflectance"):
            bad = bad | (values < 0)
        if row.nan_means:
            bad = bad & (values == values)
        if number := int(bad.any(1).sum()):
            counts[name] = number
    return counts


class BadPixelReport:
    """Counts the bad pixels of a sequence and warns once, when the first of them are met."""

    def __init__(self) -> None:
        self.total: Counter[str] = Counter()

    def look(self, frame: Frame) -> None:
        """Add a frame; warns (BadPixelWarning) if it is the first one with bad pixels."""
        counts = count_bad(frame)
        if counts and not self.total:
            listed = ", ".join(f"{number} in {name}" for name, number in counts.items())
            warnings.warn(
                f"frame {frame.index}: bad pixels (non-finite, negative or absurd) are sanitised: {listed}",
                BadPixelWarning,
                stacklevel=3,
            )
        self.total.update(counts)
