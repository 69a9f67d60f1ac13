"""A reference of other colours (order of components, white balance, colour space) is no tone curve, and told apart."""

from collections.abc import Callable

import numpy as np
import pytest
import torch

from nte.checking.exposure import ExposureTally
from nte.checking.values import Finding
from nte.frames.frame import Frame
from tests.checking.test_tone import CURVES, MULTIPLES, lights
from tests.synthetic import Pixels

ACES = np.array([[0.613, 0.340, 0.047], [0.070, 0.916, 0.013], [0.021, 0.110, 0.870]])
TINT = np.array([1.6, 1, 0.6]).reshape(3, 1, 1)
ANOTHER_SPACE = "another white balance or colour space"
OTHER_COLOURS: dict[str, tuple[Callable[[Pixels], Pixels], str]] = {
    "BGR": (lambda x: x[::-1], "order BGR"),
    "GBR": (lambda x: x[[1, 2, 0]], "order GBR"),
    "white balance": (lambda x: x * TINT, ANOTHER_SPACE),
    "ACEScg": (lambda x: np.einsum("ij,jhw->ihw", ACES, x), ANOTHER_SPACE),
    "grey": (lambda x: x.mean(0, keepdims=True).repeat(3, 0), "is grey"),
}


def told(pairs: list[tuple[Pixels, Pixels]]) -> list[Finding]:
    tally = ExposureTally()
    for i, (color, reference) in enumerate(pairs):
        both = {"color": color, "reference": reference}
        tally.add(Frame({n: torch.tensor(np.array(v, np.float32))[None] for n, v in both.items()}, i))
    return list(tally.judge())


@pytest.mark.parametrize("spp", [1, 64])
@pytest.mark.parametrize("name", OTHER_COLOURS)
def test_other_colours_are_named(name: str, spp: int) -> None:
    change, named = OTHER_COLOURS[name]
    (finding,) = told([(color, change(reference)) for color, reference in lights(spp)])
    assert finding.fault
    assert named in finding.found


@pytest.mark.parametrize("name", CURVES)
def test_a_curve_is_not_another_colour(name: str) -> None:
    assert not [f for f in told([(c, CURVES[name](r)) for c, r in lights()]) if "colours" in f.found]


@pytest.mark.parametrize("reference_spp", [0, 4, 64])
@pytest.mark.parametrize("name", MULTIPLES)
def test_nothing_is_said_of_the_same_colours(name: str, reference_spp: int) -> None:
    pairs = [(color, MULTIPLES[name](reference)) for color, reference in lights(reference_spp=reference_spp)]
    assert not [finding for finding in told(pairs) if "color, " in finding.found or "colours" in finding.found]


def test_grey_pictures_and_noise_of_each_component_are_right() -> None:
    """Some engines draw another sample for each component."""
    grey = [tuple(x.mean(0, keepdims=True).repeat(3, 0) for x in pair) for pair in lights()]
    assert not told([(color, reference) for color, reference in grey])
    rng = np.random.default_rng(3)
    for pairs in (grey, lights()):
        assert not told([(r * rng.exponential(size=r.shape), r) for _, r in pairs])
        few = [(r * 20 * (rng.random(r.shape) < 0.05), r) for _, r in pairs]
        assert not [f for f in told(few) if f.fault]
