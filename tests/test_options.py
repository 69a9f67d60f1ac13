"""Options: what a field allows is checked however it is set, and text becomes the field's type."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Literal

import pytest

from nte.errors import NteError
from nte.options import Allowed, Alpha, Count, NotNegative, Options, Positive


@dataclass(frozen=True)
class Some(Options, name="some"):
    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {"paper": {"kind": "soft", "size": 3}}

    kind: Literal["hard", "soft"] = "hard"
    size: Count = 1
    weight: Alpha = 0.5
    reach: Positive = 1.0
    noise: NotNegative = 0.0
    limit: Annotated[float, Allowed("a number above 0", lambda x: x > 0)] = 1.0
    free: float = 0.0
    fast: bool = False
    trust: bool | None = None
    radii: tuple[int, ...] = ()


@dataclass(frozen=True)
class More(Some, name="more"):
    weight: Alpha = 0.25
    extra: bool = True


def test_text_becomes_the_type_of_the_field() -> None:
    text = {
        "kind": "soft", "size": "4", "weight": "1", "reach": "2e3", "noise": "0", "limit": "inf", "free": "-1",
        "fast": "True", "trust": "false", "radii": "10-4-2",
    }  # fmt: skip
    assert Some.parse(text, "spec") == Some("soft", 4, 1.0, 2000.0, 0.0, math.inf, -1.0, True, False, (10, 4, 2))
    assert Some.parse({"fast": "0", "trust": "auto"}, "spec") == Some()
    assert Some.parse({}, "spec") == Some()


def test_a_preset_sets_what_the_others_change_in_any_order() -> None:
    assert Some.parse({"size": "7", "preset": "paper"}, "spec") == Some("soft", 7) == Some.preset("paper", size=7)
    assert Some.choices("preset") == ("paper",)
    assert Some.choices("kind") == ("hard", "soft")
    assert Some.choices("size") == ()


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"kind": "Soft"}, "some: kind is 'Soft', did you mean soft[?] expected one of hard, soft$"),
        ({"size": "0"}, "some: size is 0, expected a whole number of 1 or more"),
        ({"size": "1.0"}, "'spec': size is '1.0', expected a whole number of 1 or more"),
        ({"weight": "0"}, r"some: weight is 0.0, expected a weight of the current frame in \(0, 1\]"),
        ({"weight": "nan"}, "some: weight is nan"),
        ({"reach": "inf"}, "some: reach is inf, expected a finite number above 0"),
        ({"noise": "-1"}, "some: noise is -1.0, expected a finite number of 0 or more"),
        ({"limit": "0"}, "some: limit is 0.0, expected a number above 0"),
        ({"free": "much"}, "'spec': free is 'much', expected a number$"),
        ({"fast": "yes"}, "'spec': fast is 'yes', expected true or false"),
        ({"trust": "maybe"}, "'spec': trust is 'maybe', expected one of auto, true, false"),
        ({"radii": "4,2"}, "'spec': radii is '4,2', expected whole numbers such as 10-4-2-2"),
        ({"preset": "ours"}, "some: preset is 'ours', expected one of paper$"),
        ({"pace": "1"}, "'spec': unknown option 'pace', expected one of kind, size, .*, radii, preset$"),
    ],
)
def test_what_is_wrong_is_said_with_what_is_right(wrong: dict[str, str], message: str) -> None:
    with pytest.raises(NteError, match=message) as error:
        Some.parse(wrong, "spec")
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    "wrong",
    [
        {"size": True},
        {"size": 2.0},
        {"free": "1"},
        {"free": False},
        {"fast": 1},
        {"kind": None},
        {"radii": [1]},
        {"radii": (1.5,)},
    ],
)
def test_a_value_of_another_type_is_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(NteError, match=f"some: {next(iter(wrong))} is "):
        Some(**wrong)


def test_options_of_a_kind_add_and_change_defaults_under_their_own_name() -> None:
    assert More().weight == 0.25
    assert More.names() == (*Some.names()[:-1], "extra", "preset")
    with pytest.raises(NteError, match="more: weight is 2"):
        More(weight=2)


def test_a_field_that_no_text_can_say_is_an_error_of_the_programmer() -> None:
    @dataclass(frozen=True)
    class Odd(Options, name="odd"):
        names_of: dict[str, str] | None = None

    with pytest.raises(TypeError, match="cannot be the type of an option"):
        Odd()
