"""The precision that a training computes in."""

from dataclasses import replace

import pytest
import torch

from nte.models.temporal import TemporalConfig
from nte.training import step
from nte.training.config import TrainConfig
from nte.training.step import make_loss
from tests.networks import small_network


@pytest.mark.parametrize("faster", [torch.bfloat16, torch.float32])
def test_the_precision_is_the_one_that_is_faster_here(faster: torch.dtype, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(step, "convolution_peak", lambda device, kind, training: 2e9 if kind == faster else 1e9)
    cpu, config = torch.device("cpu"), TrainConfig(network=TemporalConfig(), precision="auto")
    assert make_loss(small_network(), config, cpu).mixed == (faster == torch.bfloat16)
    for precision, mixed in (("32-true", False), ("bf16-mixed", True)):
        assert make_loss(small_network(), replace(config, precision=precision), cpu).mixed == mixed


def test_measuring_the_precision_draws_nothing_from_the_seed() -> None:
    network = small_network()
    torch.manual_seed(1)
    expected = torch.rand(3)
    torch.manual_seed(1)
    make_loss(network, TrainConfig(network=TemporalConfig(), precision="auto"), torch.device("cpu"))
    assert torch.equal(torch.rand(3), expected)
