"""A denoiser on top of another one, whose image of the same frame it sees and mixes in: the channel `prior`."""

from typing import NamedTuple

from nte.denoiser import Denoiser, Result, State, label_of
from nte.errors import NteError
from nte.filters.named import load_filter
from nte.frames.channels import CHANNELS, GUIDES, PRIOR
from nte.frames.frame import Array, Frame
from nte.recurrence import FORWARD


def complete(denoiser: Denoiser, device: str = "cpu", ahead: bool = False) -> Denoiser:
    """Put a network that builds on another denoiser's image on top of that one; any other denoiser stays as it is.

    ahead: let the denoiser below see the next frame. Raises NteError if it cannot, and for a `prior` that is no
    denoiser by name, since a model's file must not name other files to be loaded, or that denoises something else.
    """
    if not denoiser.prior:
        if ahead:
            raise NteError(f"{label_of(denoiser)} does not look ahead: it builds on no other denoiser: leave out ahead")
        return denoiser
    below = denoiser.prior
    if ahead:
        below += ("," if ":" in below else ":") + "ahead=true"
    try:
        return OnTop(denoiser, load_filter(below, device))
    except NteError as error:
        raise NteError(f"prior: {error}") from error


class _Both(NamedTuple):
    below: State
    top: State


class OnTop(Denoiser):
    """A denoiser that needs the channel `prior`, and the denoiser that makes it; costs the time of both.

    top: takes `prior`. below: denoises the same target. Target, extras and components are those of `top`. A frame needs
    what `below` does; what else `top` wants counts as unknown where it is missing (`wants` lists it): without motion
    vectors there is no history, and without depth and guides none either, since nothing tells where it is hidden. The
    image is then about that of `below`. Raises NteError if the targets differ.
    """

    # What a released model loses is printed by benchmarks/lacking.py, and stands in docs/released.md. With motion, but
    # neither depth nor guides, `steady` would be 0.1 dB behind OIDN in the mean, and 2.7 in one of twelve clips.

    def __init__(self, top: Denoiser, below: Denoiser) -> None:
        if top.target != below.target:
            raise NteError(f"a denoiser of {below.target}, expected a denoiser of {top.target}")
        self.top, self.below = top, below
        self.target, self.extras, self.components = top.target, top.extras, top.components
        self.label = label_of(top)
        self.needs = below.needs
        self.wants = tuple(name for name in top.needs if name not in (*below.needs, PRIOR))
        others = dict.fromkeys((*self.wants, *top.optional, *below.optional))
        self.optional = tuple(name for name in others if name not in self.needs)

    def settings(self, frame: Frame) -> str:
        """Return the settings of the denoiser below for a frame like this one."""
        return self.below.settings(frame)

    def step(self, frame: Frame, state: _Both | None, extras: tuple[str, ...] = ()) -> tuple[Result, _Both]:
        """Run the denoiser below, and then the one on top with its image."""
        before = _Both(None, None) if state is None else state
        prior, below = self.below.step(frame, before.below)
        whole = frame.with_channels(prior=prior.image, **self._unknown(frame))
        result, top = self.top.step(whole, before.top, extras)
        return result, _Both(below, top)

    def _unknown(self, frame: Frame) -> dict[str, Array]:
        """NaN (N, C, H, W) for each channel that is missing, and for vectors if nothing tells where they fail."""
        names = {name for name in self.wants if name not in frame}
        if not any(name in frame for name in ("depth", *GUIDES)):
            names |= {"motion", FORWARD} & {*self.wants, *frame.channels}
        like = frame[self.target][:, :1] * float("nan")
        return {name: like[:, [0] * len(CHANNELS[name].components)] for name in names}
