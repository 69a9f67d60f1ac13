"""A denoiser on top of another one, whose image of the same frame it sees and mixes in: the channel `prior`."""

from typing import NamedTuple

from nte.denoiser import Denoiser, Result, State
from nte.errors import NteError
from nte.filters.named import load_filter
from nte.frames.channels import PRIOR
from nte.frames.frame import Frame


def complete(denoiser: Denoiser, device: str = "cpu") -> Denoiser:
    """Put a network that builds on another denoiser's image on top of that one; any other denoiser stays as it is.

    Raises NteError for a `prior` that is no denoiser by name, since a model's file must not name other files to be
    loaded, or that denoises something else.
    """
    if not denoiser.prior:
        return denoiser
    try:
        return OnTop(denoiser, load_filter(denoiser.prior, device))
    except NteError as error:
        raise NteError(f"prior: {error}") from error


class _Both(NamedTuple):
    below: State
    top: State


class OnTop(Denoiser):
    """A denoiser that needs the channel `prior`, and the denoiser that makes it; costs the time of both.

    top: takes `prior`. below: denoises the same target. Target, extras and components are those of `top`. Raises
    NteError if the targets differ.
    """

    def __init__(self, top: Denoiser, below: Denoiser) -> None:
        if top.target != below.target:
            raise NteError(f"a denoiser of {below.target}, expected a denoiser of {top.target}")
        self.top, self.below = top, below
        self.target, self.extras, self.components = top.target, top.extras, top.components
        self.needs = tuple(dict.fromkeys(name for name in (*top.needs, *below.needs) if name != PRIOR))
        both = dict.fromkeys((*top.optional, *below.optional))
        self.optional = tuple(name for name in both if name not in self.needs)

    def settings(self, frame: Frame) -> str:
        """Return the settings of the denoiser below for a frame like this one."""
        return self.below.settings(frame)

    def step(self, frame: Frame, state: _Both | None, extras: tuple[str, ...] = ()) -> tuple[Result, _Both]:
        """Run the denoiser below, and then the one on top with its image."""
        before = _Both(None, None) if state is None else state
        prior, below = self.below.step(frame, before.below)
        result, top = self.top.step(frame.with_channels(prior=prior.image), before.top, extras)
        return result, _Both(below, top)
