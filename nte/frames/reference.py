"""Which pixels of a reference say something: those that are NaN, infinite or negative do not."""

from pathlib import Path

from nte.errors import NteError
from nte.frames.frame import Array, Frame

MOST_BAD = 0.1  # share of a frame's pixels: beyond, what is left is no picture of the scene


class BadReferenceWarning(UserWarning):
    """Some pixels of a reference say nothing, and are left out of losses and scores."""


def usable_pixels(reference: Array) -> Array:
    """(N, 1, H, W) bool of a reference (N, C, H, W), NumPy or PyTorch: finite and not negative in all components."""
    return ((reference >= 0) & (reference < float("inf"))).all(1)[:, None]


def count_bad_pixels(frame: Frame, name: str, clip: Path | str) -> int:
    """How many pixels of the reference `name` say nothing.

    Raises NteError, naming the clip, for more than MOST_BAD of the frame's.
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
    """Say in one line which frame of a clip was the first with such pixels."""
    return (
        f"{clip}, frame {index}: {bad} pixels of '{name}' are NaN, infinite or negative; such pixels are left out "
        "here and in later frames"
    )
