"""What every test may rely on: one thread for PyTorch, in this process and in those that tests start."""

import os
from collections.abc import Iterator
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")  # small tensors: more threads only wait for each other

import pytest
import torch

from tests.synthetic import disc_clip

torch.set_num_threads(1)


@pytest.fixture(autouse=True)
def _deterministic_setting_stays_local() -> Iterator[None]:
    """Training switches deterministic algorithms on for its process; the next test starts without."""
    yield
    if torch.are_deterministic_algorithms_enabled():
        torch.use_deterministic_algorithms(False)


@pytest.fixture(scope="session")
def noisy_disc(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A clip of four noisy frames of 40×24 in which a disc moves to the right. Only to be read."""
    folder = tmp_path_factory.mktemp("clips") / "disc"
    return disc_clip(folder, frames=4, seed=1, size=(24, 40), start=(10.0, 12.0), radius=6.0)
