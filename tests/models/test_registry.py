"""What makes a network that others can use, and what is refused before it trains in vain."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from torch import Tensor, nn

from nte.errors import NteError
from nte.frames.frame import Frame
from nte.models.registry import KINDS, make_network, network_type
from nte.models.temporal import TemporalConfig
from nte.models.trainable import NetworkConfig, TrainableDenoiser
from nte.recurrence import Recurrent


@dataclass
class PlainConfig(NetworkConfig):
    """No choices."""

    kind: str = f"{__name__}:Plain"


class Plain(TrainableDenoiser):
    """Scales its input."""

    Config = PlainConfig
    needs = ("color",)

    def __init__(self, config: PlainConfig) -> None:
        super().__init__(config)
        self.scale = nn.Conv2d(3, 3, 1)

    def forward(self, color: Tensor) -> tuple[Tensor]:
        """(image,)."""
        return (self.scale(color),)


class Bare(TrainableDenoiser):
    """Has no choices of its own."""


def takes_keywords(self: Plain, *, color: Tensor) -> tuple[Tensor]:
    """What a call by name can give, and a graph cannot."""
    return (color,)


def takes_scattered(self: Plain, color: Tensor, previous_forward_motion: Tensor) -> tuple[Tensor]:
    """What cannot be made without motion and depth."""
    return (color,)


@pytest.mark.parametrize("kind", KINDS)
def test_every_row_is_a_network_that_its_own_choices_make(kind: str) -> None:
    made = network_type(kind)
    config = made.Config(kind=kind)
    network = make_network(config)
    assert type(network) is made
    assert network.config == config
    assert set(network.inputs) >= set(network.recurrent)
    assert network.outputs[0] == "image"


def test_a_network_without_a_past_is_one_too() -> None:
    network = make_network(PlainConfig())
    assert (network.inputs, network.outputs, network.optional, network.extras) == (("color",), ("image",), (), ())


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"needs": ("color", "colour")}, "takes the channel 'colour', which is not in the table"),
        ({"target": "albedo"}, "has the target 'albedo', expected one of color, visibility, glossy, indirect"),
        ({"needs": ("albedo",)}, "its forward takes 'color', expected one of albedo, depth_scale, exposure, reset"),
        ({"recurrent": {"color": Recurrent("next", 3)}}, "carries 'color', which is an input already"),
        ({"recurrent": {"reset": Recurrent("next", 1)}}, "carries 'reset', which is an input already"),
        ({"recurrent": {"past": Recurrent("depth", 1)}}, "carries 'depth' on, which its forward does not take"),
        ({"recurrent": {"past": Recurrent("next", 1, scale=0)}}, "carries 'past' as .*, expected components and scale"),
        ({"recurrent": {"past": Recurrent("exposure", 0)}}, "carries 'exposure' on, which its forward does not take"),
        (
            {"recurrent": {"past": Recurrent("next", 0)}},
            "carries 'past' as .*, and 0 components only for reset, exposure",
        ),
        ({"extras": ("color",)}, "takes and gives 'color'"),
        ({"forward": takes_keywords}, r"its forward takes 'color: .*Tensor' in a way that export cannot give it"),
        ({"forward": takes_scattered}, "takes 'previous_forward_motion', which is made of motion and depth"),
    ],
)
def test_declarations_that_do_not_fit_are_refused(
    changes: dict[str, object], message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in changes.items():
        monkeypatch.setattr(Plain, name, value)
    with pytest.raises(NteError, match=message):
        make_network(PlainConfig())


@pytest.mark.parametrize(
    "kind", ["", "kpcn", ":Class", "nte.models.temporal:", "../file:Class", ".models:Class", 3, None, ["temporal"]]
)
def test_what_names_no_network(kind: object) -> None:
    with pytest.raises(NteError, match=r"'network.kind' is .* expected .*, or package.module:Class"):
        network_type(kind)


def test_a_class_that_is_no_network() -> None:
    for place in ("nte.models.temporal:TemporalConfig", "nte.models.temporal:Nothing"):
        with pytest.raises(NteError, match=r"nte\.models\.temporal has no TrainableDenoiser of that name"):
            network_type(place)
    with pytest.raises(NteError, match=r"there is no module 'nte.nowhere'"):
        network_type("nte.nowhere:Network")


def test_a_class_without_choices_of_its_own() -> None:
    with pytest.raises(NteError, match="Bare has no Config, expected a dataclass based on NetworkConfig"):
        network_type(f"{__name__}:Bare")


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("raise ValueError('first\\nsecond')", "ValueError: first$"),
        ("from nte import nothing", "ImportError: cannot import name 'nothing'"),
        ("import nothing_such", "ModuleNotFoundError: No module named 'nothing_such'"),
        ("def f(:", "SyntaxError"),
    ],
)
def test_a_file_that_cannot_be_imported(text: str, what: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "faulty_network.py").write_text(text, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(NteError, match=f"faulty_network cannot be imported: {what}"):
        network_type("faulty_network:Network")


@pytest.mark.parametrize("given", ["a tensor", "too many"])
def test_a_forward_that_gives_something_else_is_told(given: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """One tensor of a batch of one would pass for a tuple of one image."""
    made = {"a tensor": lambda self, color: self.scale(color), "too many": lambda self, color: (color, color)}
    monkeypatch.setattr(Plain, "forward", made[given])
    frame = Frame({"color": np.ones((1, 3, 8, 8), np.float32)})
    with pytest.raises(NteError, match=r"Plain\.forward gives (a Tensor|2 tensors), expected a tuple: image"):
        make_network(PlainConfig()).step(frame, None)


def test_a_wrong_choice_is_named() -> None:
    with pytest.raises(NteError, match=r"network\.front is 3"):
        make_network(TemporalConfig(front=3))


def test_recurrent_tensors_cover_the_image_rounded_up() -> None:
    assert Recurrent("x", 8, scale=4).shape(2, 45, 64) == (2, 8, 12, 16)
    assert Recurrent("exposure", 0).shape(2, 45, 64) == (2,)
