"""A family of scenes: a function of random choices, and of parameters that a recipe may set."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Generic, TypeVar

import numpy as np

from nte.errors import NteError, expected_one_of
from nte.render.world.scene import Scene

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

Parameters = TypeVar("Parameters", bound="DataclassInstance")
Number = TypeVar("Number", int, float)
Value = TypeVar("Value")
_HELD_OUT = (0.4, 0.6)  # the share of every split range that belongs to the test clips


class Dice(np.random.Generator):
    """A random generator that knows whether it makes a training or a test scene."""

    def __init__(self, rng: np.random.Generator, split: str) -> None:
        super().__init__(rng.bit_generator)
        self.split = split

    def apart(self, low: float, high: float) -> float:
        """Return a number in [low, high] that is never the same in training and in test scenes.

        Test scenes draw from the middle fifth of the range, training scenes from both sides of it. So a network is
        tested within the range that it has learned from, on values that it has not seen.
        """
        start, end = _HELD_OUT
        share = self.uniform()
        if self.split == "test":
            share = start + (end - start) * share
        else:
            share *= 1 - (end - start)
            share += (end - start) * (share >= start)
        return low + (high - low) * share


@dataclass(frozen=True)
class Family(Generic[Parameters]):
    """Scenes of one kind. `parameters` is a dataclass whose defaults apply to whatever a recipe does not set.

    media: whether light is scattered on its way, so that it cannot be separated at the first surface.
    """

    parameters: type[Parameters]
    make: Callable[[Dice, Parameters], Scene]
    media: bool = False

    def __call__(
        self, rng: np.random.Generator, split: str = "train", given: Mapping[str, object] | None = None
    ) -> Scene:
        """Make one scene; `given` sets parameters by name. Raises NteError as `read` does."""
        return self.make(Dice(rng, split), self.read(given or {}))

    def read(self, given: Mapping[str, object]) -> Parameters:
        """Return the parameters with those in `given` set. Raises NteError that says what was expected."""
        known = {entry.name: entry for entry in fields(self.parameters)}
        for name, value in given.items():
            if name not in known:
                what = expected_one_of(name, known) if known else ": this scene has none"
                raise NteError(f"'{name}' is not a parameter{what}")
            kind, expected = type(known[name].default), known[name].metadata["expected"]
            is_whole_for_float = kind is float and type(value) is int
            if not (type(value) is kind or is_whole_for_float) or not known[name].metadata["allows"](value):
                raise NteError(f"'{name}' is {value!r}: expected {expected}")
        return self.parameters(**given)


def between(default: Number, low: float, high: float) -> Number:
    """Make a dataclass field for a number in [low, high]; a whole number if the default is one."""
    expected = f"{'a whole number' if type(default) is int else 'a number'} from {low:g} to {high:g}"
    return _setting(default, expected, lambda value: low <= value <= high)


def one_of(*choices: str) -> str:
    """Make a dataclass field for one of these words; the first is the default."""
    return _setting(choices[0], f"one of {', '.join(choices)}", lambda value: value in choices)


def switch(default: bool) -> bool:
    """Make a dataclass field for true or false."""
    return _setting(default, "true or false", lambda value: True)


def describe(family: Family[Parameters]) -> dict[str, tuple[str, str]]:
    """Map the name of each parameter to what is allowed and its default."""
    return {entry.name: (entry.metadata["expected"], str(entry.default).lower()) for entry in fields(family.parameters)}


def _setting(default: Value, expected: str, allows: Callable[[Value], bool]) -> Value:
    return field(default=default, metadata={"expected": expected, "allows": allows})
