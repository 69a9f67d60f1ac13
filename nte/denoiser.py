"""The protocol that every denoiser follows, and functions that run one over a sequence."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import wraps
from typing import Any, ClassVar, Generic, Literal, NamedTuple, Protocol, TypeVar, cast, runtime_checkable

import numpy as np

from nte.errors import NteError, expected_one_of
from nte.frames.channels import way_to
from nte.frames.frame import Array, Frame
from nte.frames.usable import known_cap, light_cap, usable_frame
from nte.options import Options

State = Any  # what a denoiser carries from frame to frame


@dataclass(frozen=True)
class Result:
    """The result of one step: the denoised image (N, C, H, W), in the input's units, and the requested extras."""

    image: Array
    extras: Mapping[str, Array] = field(default_factory=dict)

    def like(self, frame: Frame) -> "Result":
        """Return the result as the kind of arrays that `frame` has (NumPy or PyTorch), on the frame's device."""
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
    """The interface of every denoiser: analytic filter, network, exported model or external program.

    To write a denoiser, inherit from this class and define `needs` and `step`; everything else has a default.
    """

    needs: tuple[str, ...]  # channels that every frame must have
    optional: tuple[str, ...] = ()  # channels that are used where a frame has them
    wants: tuple[str, ...] = ()  # those of `optional` whose absence costs so much that a session warns of it
    target: str = "color"  # the channel whose reference the denoiser approximates
    extras: tuple[str, ...] = ()  # names of further outputs that a step returns on request
    components: tuple[str, ...] = ()  # light components that are denoised separately; each is also an extra
    prior: str = ""  # a denoiser by name, whose image of the frame is the channel `prior` (nte.filters.prior)
    label: str = ""  # what errors call it; "" for the name of its class
    device: str | None = None  # `sanitised` converts frames to PyTorch tensors on this device; None: no conversion

    def step(self, frame: Frame, state: State | None, extras: tuple[str, ...] = ()) -> tuple[Result, State]:
        """Denoise one frame and return the result and the state for the next frame.

        state: what the previous step returned; None starts a sequence. Its memory may be overwritten, unless autograd
        records. The new state shares no memory with the frame, nor with the result, so that a caller may write to both.
        extras: the names, out of `self.extras`, that the result shall contain. Raises NteError for other names.
        """
        ...

    def settings(self, frame: Frame) -> str:
        """Return the options in effect for a frame like this one, as a user would type them; "" if they are fixed."""
        return ""


def require_denoiser(found: object, where: str) -> None:
    """Raise NteError for an object that is no denoiser, such as one whose class does not inherit from Denoiser.

    where: what the caller knows it by, which begins the message.
    """
    if isinstance(found, type):
        raise NteError(f"{where}: the class {found.__name__} is given: expected an object, {found.__name__}()")
    missing = [name for name in (*Denoiser.__annotations__, "settings") if not hasattr(found, name)]
    if getattr(type(found), "step", Denoiser.step) is Denoiser.step:
        missing.append("step")
    if missing:
        what = f"{type(found).__name__} has no '{missing[0]}'"
        raise NteError(f"{where}: {what}: expected a class that inherits from nte.Denoiser, with needs and step")


class Sanitised(NamedTuple):
    """The state of a denoiser whose step is wrapped by `sanitised`."""

    cap: Any  # (N,) NumPy: radiance above which the sequence's light is clamped, NaN while unknown
    inner: State


_Step = TypeVar("_Step", bound=Callable[..., tuple[Result, State]])


def sanitised(step: _Step) -> _Step:
    """Wrap a denoiser's `step` so that it sees only usable values and gets a mask of the usable pixels.

    The module nte.frames.usable defines what is usable. Channels that the denoiser does not read stay as they are. If
    the denoiser has a `device`, arrays become PyTorch tensors on it; the result has the kind of arrays that was given.
    The state holds the clamp for radiance beside the step's own state. Raises NteError, before any computation, for
    extras that the denoiser does not have.
    """

    @wraps(step)
    def whole(
        self: Denoiser, frame: Frame, state: Sanitised | None, extras: tuple[str, ...] = ()
    ) -> tuple[Result, Sanitised]:
        require_extras(self, extras)
        given = frame if self.device is None else frame.torch(self.device)
        before = Sanitised(None, None) if state is None else state
        cap = light_cap(given, before.cap)
        usable = usable_frame(given, (*self.needs, *self.optional), known_cap(cap))
        result, inner = step(self, usable, before.inner, extras)
        return result.like(frame), Sanitised(cap, inner)

    return cast(_Step, whole)


OptionsType = TypeVar("OptionsType", bound=Options)


class Filter(Denoiser, Generic[OptionsType]):
    """Base class of the denoisers that can be loaded by name: each is constructed from options and a device.

    options: an instance of `options_type`; None takes the defaults. device: where PyTorch computes, such as "cpu" or
    "cuda"; a class whose `uses_device` is false ignores it. Raises NteError for options of another type.
    """

    options_type: type[OptionsType]
    uses_device: ClassVar[bool] = True

    def __init__(self, options: OptionsType | None = None, *, device: str = "cpu") -> None:
        wanted = self.options_type
        if options is not None and not isinstance(options, wanted):
            raise NteError(f"{type(self).__name__} takes {wanted.__name__}, not {options!r:.60}")
        self.options: OptionsType = wanted() if options is None else options
        self.device = device if self.uses_device else None


@dataclass(frozen=True)
class NoisyOptions(Options, name="noisy"):
    """Options of Noisy. target: the channel that is returned."""

    target: Literal["color", "visibility", "glossy", "indirect"] = "color"


class Noisy(Filter[NoisyOptions]):
    """The noisy input, unchanged: the baseline that every denoiser must beat."""

    needs: tuple[str, ...] = ("color",)
    options_type = NoisyOptions
    uses_device = False

    def __init__(self, options: NoisyOptions | None = None, *, device: str = "cpu") -> None:
        super().__init__(options, device=device)
        self.target = self.options.target
        self.needs = (self.target,)

    @sanitised
    def step(self, frame: Frame, state: State | None, extras: tuple[str, ...] = ()) -> tuple[Result, State]:
        """Return the target as it is, with bad pixels replaced."""
        return Result(frame[self.target]), ()


def label_of(denoiser: Denoiser) -> str:
    """What errors call a denoiser: its label, or the name of its class."""
    return denoiser.label or type(denoiser).__name__


def require_channels(denoiser: Denoiser, available: Iterable[str], where: object) -> None:
    """Raise NteError if a channel that the denoiser needs is not available; the error names all that are missing.

    where: the frame or file, which begins the message.
    """
    have = tuple(available)
    missing = [name for name in denoiser.needs if name not in have]
    if missing:
        what = f"{where}: {label_of(denoiser)} needs {', '.join(missing)}, which is missing; there is {', '.join(have)}"
        raise NteError(what + way_to(missing))


def require_extras(denoiser: Denoiser, asked: Iterable[str], where: object = "") -> None:
    """Raise NteError for the first extra that the denoiser does not have; the error lists those that it has.

    where: the frame or file, which begins the message; "" for none.
    """
    if unknown := [name for name in asked if name not in denoiser.extras]:
        name = f"{where}: " if where else ""
        instead = expected_one_of(unknown[0], denoiser.extras)
        raise NteError(f"{name}{label_of(denoiser)} has no extra '{unknown[0]}'{instead}")


def require_size(frame: Frame, history: Array) -> None:
    """Raise NteError if the frame's batch or size differs from that of the sequence's history (N, C, H, W)."""
    refuse_other_size(frame, (history.shape[0], *history.shape[2:]))


def refuse_other_size(frame: Frame, was: tuple[int, ...]) -> None:
    """Raise NteError if the frame's (batch, height, width) differs from `was`, that of the frames before."""
    now = frame.batch, *frame.size
    if now != was:
        raise NteError(
            f"frame {frame.index}: (batch, height, width) is {now} after {was}: start a new sequence "
            "(Session.reset, or state None) for another size"
        )
