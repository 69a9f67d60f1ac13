"""Usable pixels of a reference: those that are NaN, infinite or negative carry no information."""

from pathlib import Path

from nte.errors import NteError
from nte.frames.frame import Array, Frame

MOST_BAD = 0.1  # largest share of bad pixels: with more, the rest is no picture of the scene


class BadReferenceWarning(UserWarning):
    """Warning that some pixels of a reference are unusable, and are left out of losses and scores."""


def usable_pixels(reference: Array) -> Array:
    """Mark the usable pixels of a reference (N, C, H, W), NumPy or PyTorch, as a bool mask (N, 1, H, W).

    A pixel is usable if all its components are finite and not negative.
    """
    return ((reference >= 0) & (reference < float("inf"))).all(1)[:, None]


def count_bad_pixels(frame: Frame, name: str, clip: Path | str) -> int:
    """Count the unusable pixels of the reference `name`: NaN, infinite or negative in any component.

    Raises NteError, naming the clip, if they are more than MOST_BAD (a tenth) of the frame's pixels.
    """
    usable = usable_pixels(frame[name])
    height, width = frame.size
    pixels = frame.batch * height * width
    bad = pixels - int(usable.sum())
    if bad > MOST_BAD * pixels:
        raise NteError(
            f"{clip}, frame {frame.index}: {bad} of {pixels} pixels of '{name}' are NaN, infinite or negative: "
            f"expected at most {MOST_BAD:.0%}: render or import it again"
        )
    return bad


def describe_bad_pixels(bad: int, name: str, clip: Path | str, index: int) -> str:
    """Say in one line which frame of a clip was the first with unusable reference pixels, and how many it has."""
    return (
        f"{clip}, frame {index}: {bad} pixels of '{name}' are NaN, infinite or negative; such pixels are left out "
        "here and in later frames"
    )
