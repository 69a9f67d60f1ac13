"""Everything is a denoiser: the protocol, and running one over a sequence."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import wraps
from typing import Any, ClassVar, Generic, NamedTuple, Protocol, TypeVar, cast, runtime_checkable

import numpy as np

from nte.errors import NteError
from nte.frames.bad import BadPixelReport
from nte.frames.channels import CHANNELS
from nte.frames.frame import Array, Frame
from nte.frames.usable import known_cap, light_cap, usable_frame
from nte.options import Options

State = Any  # whatever a denoiser carries from frame to frame


@dataclass(frozen=True)
class Result:
    """What a step gives: the denoised image (N, C, H, W) in the input's units, and the extras asked for."""

    image: Array
    extras: Mapping[str, Array] = field(default_factory=dict)

    def like(self, frame: Frame) -> "Result":
        """The result with the kind of arrays that `frame` has, on their device: a denoiser returns what it is given."""
        given = frame[next(iter(frame.channels))]
        if getattr(given, "device", "cpu") == getattr(self.image, "device", "cpu") and (
            isinstance(given, np.ndarray) == isinstance(self.image, np.ndarray)
        ):
            return self

        def convert(array: Array) -> Array:
            if isinstance(given, np.ndarray):
                return array.detach().cpu().numpy()
            return given.new_tensor(array) if isinstance(array, np.ndarray) else array.to(given.device)

        return Result(convert(self.image), {name: convert(array) for name, array in self.extras.items()})


@runtime_checkable
class Denoiser(Protocol):
    """An analytic filter, a network, an exported model or somebody else's denoiser, all used the same way.

    A class of yours inherits from this one and has `needs` and `step`; the rest has defaults.
    """

    needs: tuple[str, ...]  # channels it must have
    optional: tuple[str, ...] = ()  # channels it uses if there
    target: str = "color"  # the channel whose reference it approximates
    extras: tuple[str, ...] = ()  # names of what a step gives besides the image, where it is asked to
    components: tuple[str, ...] = ()  # light components that it denoises apart; they are extras
    device: str | None = None  # on which `sanitised` hands it PyTorch tensors; None: it gets what there is

    def step(self, frame: Frame, state: State | None, extras: tuple[str, ...] = ()) -> tuple[Result, State]:
        """Denoise one frame. `state` is what the step before returned; None starts a sequence.

        extras: names out of `self.extras`, which the result then has; NteError for others. The given state may be
        overwritten, except while autograd records.
        """
        ...

    def settings(self, frame: Frame) -> str:
        """Describe what its options come to on a frame like this one, as they would be typed; "" if they are fixed."""
        return ""


class Sanitised(NamedTuple):
    """The state of a denoiser whose step is `sanitised`."""

    cap: Any  # (N,) NumPy: the radiance at which the sequence's light is capped, NaN while unknown
    inner: State


_Step = TypeVar("_Step", bound=Callable[..., tuple[Result, State]])


def sanitised(step: _Step) -> _Step:
    """Wrap a denoiser's `step`: it sees usable values only (nte.frames.usable), and masks of the pixels that are.

    Channels that the denoiser does not read stay as they are. Arrays become tensors on its `device`, where it has
    one; the result is of the kind that was given. The cap on light is carried in the state, beside the step's own.
    Raises NteError, before anything is computed, for extras that it does not have.
    """

    @wraps(step)
    def whole(
        self: Denoiser, frame: Frame, state: Sanitised | None, extras: tuple[str, ...] = ()
    ) -> tuple[Result, Sanitised]:
        check_extras(self, extras)
        given = frame if self.device is None else frame.torch(self.device)
        before = Sanitised(None, None) if state is None else state
        cap = light_cap(given, before.cap)
        usable = usable_frame(given, (*self.needs, *self.optional), known_cap(cap))
        result, inner = step(self, usable, before.inner, extras)
        return result.like(frame), Sanitised(cap, inner)

    return cast(_Step, whole)


OptionsType = TypeVar("OptionsType", bound=Options)


class Filter(Denoiser, Generic[OptionsType]):
    """Base of the denoisers that have a name: they are made of options and a device.

    options: of `options_type`; None takes the defaults. device: on which PyTorch computes; one with `uses_device`
    false ignores it. Raises NteError for options of another kind.
    """

    options_type: type[OptionsType]
    uses_device: ClassVar[bool] = True

    def __init__(self, options: OptionsType | None = None, *, device: str = "cpu") -> None:
        wanted = self.options_type
        if options is not None and not isinstance(options, wanted):
            raise NteError(f"{type(self).__name__} takes {wanted.__name__}, not {options!r:.60}")
        self.options: OptionsType = wanted() if options is None else options
        self.device = device if self.uses_device else None


class Noisy(Filter[Options]):
    """The input itself: the baseline that everything must beat."""

    needs: tuple[str, ...] = ("color",)
    options_type = Options
    uses_device = False

    @sanitised
    def step(self, frame: Frame, state: State | None, extras: tuple[str, ...] = ()) -> tuple[Result, State]:
        """Return `color` as it is, without bad pixels."""
        return Result(frame["color"]), ()


def check_needs(denoiser: Denoiser, available: Iterable[str], where: object) -> None:
    """Raise NteError naming every channel that the denoiser needs and that is not available."""
    have = tuple(available)
    missing = [name for name in denoiser.needs if name not in have]
    if missing:
        name = type(denoiser).__name__
        groups = sorted({CHANNELS[channel].group for channel in missing if channel in CHANNELS} - {"every clip"})
        way = f"; nte render writes it in groups that set {' and '.join(groups)}" if groups else ""
        raise NteError(f"{where}: {name} needs {', '.join(missing)}, which is missing; there is {', '.join(have)}{way}")


def check_extras(denoiser: Denoiser, asked: Iterable[str], where: object = "") -> None:
    """Raise NteError that names the first extra asked for that the denoiser does not have, and those that it has."""
    if unknown := [name for name in asked if name not in denoiser.extras]:
        has = ", ".join(denoiser.extras) or "none"
        name = f"{where}: " if where else ""
        raise NteError(f"{name}{type(denoiser).__name__} has no extra '{unknown[0]}'; it has {has}")


def check_size(frame: Frame, history: Array) -> None:
    """Raise NteError where a frame has another batch or size than the sequence's history (N, C, H, W)."""
    refuse_other_size(frame, (history.shape[0], *history.shape[2:]))


def refuse_other_size(frame: Frame, was: tuple[int, ...]) -> None:
    """Raise NteError where a frame's (batch, height, width) is not what it was in the frames before."""
    now = frame.batch, *frame.size
    if now != was:
        raise NteError(
            f"frame {frame.index}: (batch, height, width) is {now} after {was}: start a new sequence (state None) "
            "for another size"
        )


def denoise(denoiser: Denoiser, frames: Iterable[Frame], extras: tuple[str, ...] = ()) -> Iterator[Result]:
    """Denoise a sequence lazily, one result per frame; bad pixels are reported once (BadPixelWarning).

    >>> clip = nte.Clip("data/clips/disc_000")
    >>> for result in nte.denoise(nte.load_denoiser("taa"), clip):
    ...     image = result.image  # (1, 3, H, W), linear, in the input's units
    >>> image.shape == (1, 3, clip.height, clip.width)
    True
    """
    session = Session(denoiser)
    return (session.step(frame, extras) for frame in frames)


class Session:
    """A denoiser with its state inside, for those who want an object: `denoise(frame)` and `reset()`.

    Frames are counted: one whose `index` is that of the frame given before it, as all are that never set one, gets the
    number after that frame's, since what a denoiser draws at random must differ from frame to frame. Any other index
    is taken as it is.

    >>> session = nte.Session(nte.load_denoiser("taa"))
    >>> images = [session.denoise(frame) for frame in nte.Clip("data/clips/disc_000")]
    >>> session.reset()  # the next frame starts a sequence
    """

    def __init__(self, denoiser: Denoiser) -> None:
        self.denoiser = denoiser
        self.reset()

    def reset(self) -> None:
        """Forget the past: the next frame starts a sequence."""
        self._state: State | None = None
        self._bad = BadPixelReport()
        self._given: int | None = None  # index of the frame before, as it came
        self._counted = 0  # and as the denoiser saw it

    def denoise(self, frame: Frame) -> Array:
        """The denoised image (N, C, H, W) of the next frame, in the input's units."""
        return self.step(frame).image

    def step(self, frame: Frame, extras: tuple[str, ...] = ()) -> Result:
        """The next frame's image and the extras asked for.

        Raises NteError for missing channels, and for extras that the denoiser does not have.
        """
        counted = self._counted + 1 if frame.index == self._given else frame.index
        self._given, self._counted = frame.index, counted
        frame = replace(frame, index=counted)
        check_needs(self.denoiser, frame.channels, f"frame {frame.index}")
        check_extras(self.denoiser, extras)
        self._bad.look(frame)
        result, self._state = self.denoiser.step(frame, self._state, extras)
        return result
