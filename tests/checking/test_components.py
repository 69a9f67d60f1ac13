"""Light components must add up to the colour, whatever the light is."""

from collections.abc import Callable

import numpy as np
import pytest
import torch

from nte.checking.components import SUMMED, ComponentTally
from nte.checking.values import Finding
from nte.frames.frame import Frame
from tests.synthetic import Pixels

Parts = dict[str, Pixels]


def parts(seed: int) -> Parts:
    rng = np.random.default_rng(seed)
    found: Parts = {n: rng.exponential(size=(3, 20, 30)).astype(np.float32) for n in SUMMED}
    found["visibility"] = (rng.random((1, 20, 30)) < 0.5).astype(np.float32)
    found["emission"] *= rng.random((1, 20, 30)) < 0.1
    total = found["emission"] + found["direct"] * found["visibility"] + found["glossy"] + found["indirect"]
    return found | {"color": total.astype(np.float32)}


def told(change: Callable[[Parts], Parts]) -> list[Finding]:
    tally = ComponentTally()
    for i in range(3):
        changed = parts(i)
        changed |= change(changed)
        tally.add(Frame({n: torch.tensor(np.array(v, np.float32))[None] for n, v in changed.items()}, i))
    return list(tally.judge())


@pytest.mark.parametrize(
    "change",
    [
        lambda f: {},
        lambda f: {n: f[n].astype(np.float16) for n in SUMMED},
        lambda f: {n: 1e-4 * f[n] for n in SUMMED if n != "visibility"},
        lambda f: {"color": np.where(np.arange(30) == 3, np.nan, f["color"])},
        lambda f: {n: 0 * f[n] for n in SUMMED},
    ],
    ids=["right", "half floats", "another unit", "not finite", "black"],
)
def test_nothing_is_said_of_components_that_add_up(change: Callable[[Parts], Parts]) -> None:
    assert told(change) == []


@pytest.mark.parametrize("name", SUMMED)
@pytest.mark.parametrize("change", [lambda x: 2 * x, lambda x: x[:, ::-1], lambda x: 0 * x], ids=["2", "turned", "0"])
def test_a_component_of_other_light_is_told(name: str, change: Callable[[Pixels], Pixels]) -> None:
    (finding,) = told(lambda f: {name: change(f[name])})
    assert finding.fault
    assert "is no sum of its components" in finding.found


@pytest.mark.parametrize("change", [lambda x: 2 * x, lambda x: x[:, ::-1]], ids=["2", "turned"])
def test_emission_that_exceeds_color_is_a_doubt(change: Callable[[Pixels], Pixels]) -> None:
    """Other components may be missing."""
    tally = ComponentTally()
    for i in range(3):
        lamp = np.zeros((3, 20, 30), np.float32)
        lamp[:, 3:8, 10:20] = 5
        light = parts(i)["indirect"] + lamp
        given = {"color": light, "emission": np.ascontiguousarray(change(lamp))}
        tally.add(Frame({name: torch.tensor(values)[None] for name, values in given.items()}, i))
    (finding,) = tally.judge()
    assert (finding.channel, finding.doubt, finding.fault) == ("emission", True, False)
