"""A finished run that many tests look at."""

from pathlib import Path

import pytest

from nte.training.loop import train
from tests.training.runs import tiny_config


@pytest.fixture(scope="session")
def finished(tmp_path_factory: pytest.TempPathFactory, noisy_disc: Path) -> Path:
    """A run of 8 steps that nothing disturbed. Only to be read."""
    folder = tmp_path_factory.mktemp("finished")
    return train(tiny_config(folder, noisy_disc), device="cpu")
