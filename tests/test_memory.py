"""Peak memory: one unit, whatever the operating system counts in."""

import resource
import sys
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from nte.memory import peak_resident_mb
from nte.training.meter import Meter


def read(meter: Meter) -> float:
    meter.begin()
    meter.lap("data")
    meter.end()
    return meter.read()["peak_memory_mb"]


@pytest.mark.parametrize(("platform", "counted"), [("linux", 3_000_000_000 / 1024), ("darwin", 3_000_000_000)])
def test_training_and_benchmark_mean_the_same_megabytes(
    monkeypatch: pytest.MonkeyPatch, platform: str, counted: float
) -> None:
    monkeypatch.setattr(sys, "platform", platform)
    monkeypatch.setattr(resource, "getrusage", lambda who: SimpleNamespace(ru_maxrss=counted))
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    assert peak_resident_mb() == read(Meter(1)) == pytest.approx(3000)


def test_memory_on_a_graphics_card_is_in_the_same_unit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "max_memory_allocated", lambda: 3_000_000_000)
    assert read(Meter(1)) == pytest.approx(3000)


def test_an_array_that_is_filled_counts() -> None:
    before = peak_resident_mb()
    filled = np.ones(int(2 * before * 1e6 / 8))  # twice the peak so far, so it is above it whatever was freed
    assert peak_resident_mb() >= filled.nbytes / 1e6
