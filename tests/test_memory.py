"""Peak memory: one unit, whatever the operating system counts in."""

import resource
import subprocess
import sys
from types import SimpleNamespace

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
    """In a process of its own, which is small; a shell starts it, as Linux counts the memory of who starts one, too."""
    program = """
import numpy as np
from nte.memory import peak_resident_mb
before = peak_resident_mb()
filled = np.ones(25_000_000)
print(peak_resident_mb() - before, filled.nbytes / 1e6)
"""
    by_a_shell = ["sh", "-c", '"$0" -c "$1"; exit $?', sys.executable, program]
    said = subprocess.run(by_a_shell, capture_output=True, text=True, check=True).stdout
    grown, filled = map(float, said.split())
    assert grown == pytest.approx(filled, rel=0.1)
