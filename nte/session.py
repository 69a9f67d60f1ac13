"""A denoiser over a sequence: sessions, which keep its state, and `denoise`."""

import warnings
from collections.abc import Iterable, Iterator
from dataclasses import replace

from nte.denoiser import Denoiser, Result, State, label_of, require_channels, require_extras
from nte.errors import NteError
from nte.frames.ahead import with_next
from nte.frames.bad import BadPixelReport
from nte.frames.frame import Array, Frame


class MissingChannelWarning(UserWarning):
    """Warning that frames lack channels without which the result is worse."""


def denoise(denoiser: Denoiser, frames: Iterable[Frame], extras: tuple[str, ...] = ()) -> Iterator[Result]:
    """Denoise a sequence lazily: yield one result per frame, and warn once about bad pixels (BadPixelWarning).

    Raises NteError for extras that the denoiser does not have, and for a frame that lacks a channel.

    >>> clip = nte.Clip("data/clips/disc_000")
    >>> for result in nte.denoise(nte.load_denoiser("taa"), clip):
    ...     image = result.image  # (1, 3, H, W), linear, in the input's units
    >>> image.shape == (1, 3, clip.height, clip.width)
    True
    """
    session = Session(denoiser)
    return (session.step(frame, extras) for frame in with_next(frames, denoiser.optional))


class Session:
    """A denoiser that keeps its state between calls: `denoise(frame)` for each frame, and `reset()` for a new sequence.

    The session numbers frames whose `index` is not set: if the index equals that of the frame before, or a number that
    the session has counted on to from there, the denoiser sees the next number instead, because its random numbers must
    differ from frame to frame. Any other index is passed on unchanged.

    >>> session = nte.Session(nte.load_denoiser("taa"))
    >>> images = [session.denoise(frame) for frame in nte.Clip("data/clips/disc_000")]
    >>> session.reset()  # the next frame starts a sequence
    """

    def __init__(self, denoiser: Denoiser) -> None:
        self.denoiser = denoiser
        self.reset()

    def reset(self) -> None:
        """Forget the history, so that the next frame starts a sequence."""
        self._state: State | None = None
        self._bad = BadPixelReport()
        self._given: int | None = None  # index of the frame before, as given
        self._counted = 0  # index of the frame before, as the denoiser saw it
        self._lacking: list[str] | None = None  # channels that the denoiser wants, and the sequence does not have

    def denoise(self, frame: Frame) -> Array:
        """Denoise the next frame and return its image (N, C, H, W) in the input's units.

        Raises NteError for missing channels and for a size that changes within the sequence.
        """
        return self.step(frame).image

    def step(self, frame: Frame, extras: tuple[str, ...] = ()) -> Result:
        """Denoise the next frame and return its image with the extras that are asked for.

        Raises NteError for missing channels, unknown extras, and a size that changes within the sequence.
        """
        repeated = self._given is not None and self._given <= frame.index <= self._counted
        counted = self._counted + 1 if repeated else frame.index
        self._given, self._counted = frame.index, counted
        frame = replace(frame, index=counted)
        require_channels(self.denoiser, frame.channels, f"frame {frame.index}")
        require_extras(self.denoiser, extras)
        self._bad.look(frame)
        self._look_for_wanted(frame)
        result, self._state = self.denoiser.step(frame, self._state, extras)
        return result

    def _look_for_wanted(self, frame: Frame) -> None:
        """Warn of wanted channels that a sequence lacks. Raises NteError if they are lost on the way."""
        missing = [name for name in self.denoiser.wants if name not in frame]
        where = f"frame {frame.index}: {label_of(self.denoiser)}"
        if self._lacking is None:
            self._lacking = missing
            if missing:
                what = f"{where} does without {', '.join(missing)}, which costs quality"
                warnings.warn(what, MissingChannelWarning, stacklevel=3)
        elif lost := [name for name in missing if name not in self._lacking]:
            raise NteError(f"{where} wants {', '.join(lost)}, which is missing; the frames before have it")
