"""Options as frozen dataclasses: each field declares its allowed values, is checked on construction, and parses text.

A field's type decides how text is read: bool, int, float, `Literal[…]`, `bool | None` and `int | None` (None is typed
«auto») or `tuple[int, …]` (typed 10-4-2). Limits stand beside the type, as `Annotated[float, Allowed(…)]`; limits that
several classes use have names in this module. Presets, such as a paper's settings, are named changes of the defaults.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from numbers import Integral, Real
from typing import Annotated, Any, ClassVar, Literal, NamedTuple, Self, TypeAlias, get_args, get_origin, get_type_hints

from nte.errors import NteError, did_you_mean, expected_one_of

AUTO = "auto"  # the word for None
_WORDS = {"true": True, "1": True, "false": False, "0": False}


class Allowed(NamedTuple):
    """The values that an option may take, besides being of its type, and the words by which an error describes them."""

    expected: str
    allows: Callable[[Any], bool] = lambda value: True


Alpha: TypeAlias = Annotated[float, Allowed("a weight of the current frame in (0, 1]", lambda w: 0 < w <= 1)]
Positive: TypeAlias = Annotated[float, Allowed("a finite number above 0", lambda x: 0 < x < math.inf)]
NotNegative: TypeAlias = Annotated[float, Allowed("a finite number of 0 or more", lambda x: 0 <= x < math.inf)]
Count: TypeAlias = Annotated[int, Allowed("a whole number of 1 or more", lambda n: n >= 1)]
# Of a filter whose taps lie 2^level px apart: at level 16 they lie outside of every image.
Levels: TypeAlias = Annotated[int, Allowed("a whole number from 0 to 16", lambda n: 0 <= n <= 16)]


@dataclass(frozen=True)
class Options:
    """Base class of all options; `name` is what errors and specs call the owner of the options.

    Options that others only inherit from need no name: they are called by their class's. Construction raises NteError
    for a value that is not allowed. A subclass that compares fields with each other extends `__post_init__`.
    """

    name: ClassVar[str] = ""
    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {}  # name → the fields that the preset sets

    def __init_subclass__(cls, name: str = "") -> None:
        cls.name = name or cls.__name__

    def __post_init__(self) -> None:
        for key, rule in rules_of(type(self)).items():
            value = getattr(self, key)
            if not rule.allows(value):
                raise NteError(f"{self.name}: {key} is {value!r}{rule.instead_of(value)}")

    @classmethod
    def preset(cls, preset: str, **changes: Any) -> Self:
        """Return the options of a named preset, with changes. Raises NteError for an unknown name."""
        if preset not in cls.presets:
            raise NteError(f"{cls.name}: preset is '{preset}'{expected_one_of(preset, cls.presets)}")
        return cls(**{**cls.presets[preset], **changes})

    @classmethod
    def names(cls) -> tuple[str, ...]:
        """Return the names of the options that a spec may set."""
        return *(field.name for field in fields(cls)), *(["preset"] if cls.presets else [])

    @classmethod
    def choices(cls, option: str) -> tuple[str, ...]:
        """Return the words from which `option` (or `preset`) is chosen; empty for an option of another kind."""
        return tuple(cls.presets) if option == "preset" else rules_of(cls)[option].choices

    @classmethod
    def parse(cls, given: Mapping[str, str], spec: str) -> Self:
        """Make the options from text, key → value; a `preset` sets the fields that are not given.

        spec: what the user typed; errors quote it. Raises NteError for an unknown key and for a value that is not
        allowed.
        """
        rules, changes = rules_of(cls), {}
        for key, text in given.items():
            if key not in cls.names():
                raise NteError(f"'{spec}': unknown option '{key}'{expected_one_of(key, cls.names())}")
            if key in rules:
                try:
                    changes[key] = rules[key].read(text)
                except (ValueError, KeyError):
                    raise NteError(f"'{spec}': {key} is '{text}'{rules[key].instead_of(text)}") from None
        return cls.preset(given["preset"], **changes) if "preset" in given else cls(**changes)


class Rule(NamedTuple):
    """How a field's text is read, which values it may take, and the words by which an error describes them."""

    read: Callable[[str], Any]
    allows: Callable[[Any], bool]
    expected: str
    choices: tuple[str, ...] = ()

    def instead_of(self, found: object) -> str:
        """Say what was expected instead of a value, as the end of an error; the nearest word comes first."""
        return f"{did_you_mean(found, self.choices)} expected {self.expected}"


def rules_of(options: type[Options]) -> dict[str, Rule]:
    """Return the rule of each field."""
    hints = get_type_hints(options, include_extras=True)
    return {field.name: _rule(hints[field.name]) for field in fields(options)}


def _rule(hint: Any) -> Rule:
    """The rule of a field with this type. Raises TypeError for a type that cannot be an option."""
    if get_origin(hint) is Annotated:
        kind, limit = get_args(hint)
        rule = _rule(kind)
        return rule._replace(allows=lambda value: rule.allows(value) and limit.allows(value), expected=limit.expected)
    if get_origin(hint) is Literal:
        choices = get_args(hint)
        return Rule(str, lambda value: value in choices, f"one of {', '.join(choices)}", choices)
    if hint is bool:
        return Rule(_word, lambda value: isinstance(value, bool), "true or false")
    if hint == bool | None:
        known = f"one of {AUTO}, true, false"
        return Rule(_word_or_auto, lambda value: value is None or isinstance(value, bool), known)
    if hint is int:
        return Rule(int, _is_whole, "a whole number")
    if hint == int | None:
        return Rule(_whole_or_auto, lambda n: n is None or _is_whole(n), f"{AUTO}, or a whole number")
    if hint is float:
        return Rule(float, lambda value: isinstance(value, Real) and not isinstance(value, bool), "a number")
    if hint == tuple[int, ...]:
        return Rule(_whole_numbers, _are_whole, "whole numbers such as 10-4-2-2")
    raise TypeError(f"{hint} cannot be the type of an option")


def _word(text: str) -> bool:
    return _WORDS[text.lower()]


def _word_or_auto(text: str) -> bool | None:
    return None if text.lower() == AUTO else _word(text)


def _whole_or_auto(text: str) -> int | None:
    return None if text.lower() == AUTO else int(text)


def _is_whole(value: object) -> bool:
    return isinstance(value, Integral) and not isinstance(value, bool)


def _are_whole(values: object) -> bool:
    return isinstance(values, tuple) and all(map(_is_whole, values))


def _whole_numbers(text: str) -> tuple[int, ...]:
    return tuple(int(part) for part in text.split("-"))
