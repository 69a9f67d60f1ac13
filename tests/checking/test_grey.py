"""Grey albedo of coloured textures is a doubt; of grey textures, also in coloured light and gloss, nothing is said."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from nte.checking import CheckReport
from nte.checking.borrowed import EXPECTED
from tests.checking.test_albedo import LIGHTS, of
from tests.synthetic import Pixels

GREYS: dict[str, Callable[[Pixels], Pixels]] = {
    "luminance": lambda albedo: np.einsum("i,ihw->hw", [0.2126, 0.7152, 0.0722], albedo)[None],
    "mean": lambda albedo: albedo.mean(0, keepdims=True),
}


def grey(name: str) -> Callable[[Pixels], Pixels]:
    return lambda albedo: GREYS[name](albedo).repeat(3, 0)


def doubts(report: CheckReport) -> list[str]:
    return [f.found for f in report.findings if f.channel == "albedo" and f.expected == EXPECTED]


@pytest.mark.parametrize("name", GREYS)
@pytest.mark.parametrize("light", ["as it is", "a coloured lamp", "a noisy reference"])
def test_the_luminance_of_coloured_textures_is_a_doubt(tmp_path: Path, name: str, light: str) -> None:
    report = of(tmp_path, grey(name), light)
    assert doubts(report) == ["is grey, and textures in reference have colours of which it is the luminance"]
    assert report.verdict == "undecidable"


@pytest.mark.parametrize("light", LIGHTS)
@pytest.mark.parametrize("name", GREYS)
def test_grey_textures_are_grey(tmp_path: Path, light: str, name: str) -> None:
    """Their light has the colours of lamps and of what is reflected in them."""
    report = of(tmp_path, grey(name), light, lit=grey(name))
    assert not doubts(report)
    assert report.verdict == "plausible"
