"""A finished run that many tests look at."""

from pathlib import Path

import pytest

from nte.training.loop import train
from tests.shared import made_once
from tests.training.runs import tiny_config


@pytest.fixture(scope="session")
def finished(tmp_path_factory: pytest.TempPathFactory, noisy_disc: Path) -> Path:
    """A run of 8 steps that nothing disturbed. Only to be read."""
    folder = made_once(
        tmp_path_factory, "finished", lambda folder: train(tiny_config(folder, noisy_disc), device="cpu")
    )
    return folder / "runs" / "tiny"
