"""A finished run that many tests look at, and what every training must leave behind: no thread."""

import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from nte.training.loop import train
from tests.shared import made_once
from tests.training.runs import tiny_config


def loading_threads() -> list[threading.Thread]:
    """The threads of this process that load batches."""
    return [thread for thread in threading.enumerate() if thread.name.startswith("ahead")]


@pytest.fixture(autouse=True)
def no_thread_is_left() -> Iterator[None]:
    """However a training ends: after its last step, by Ctrl-C, a divergence or a faulty clip."""
    yield
    assert not loading_threads()


@pytest.fixture(scope="session")
def finished(tmp_path_factory: pytest.TempPathFactory, noisy_disc: Path) -> Path:
    """A run of 8 steps that nothing disturbed. Only to be read."""
    folder = made_once(
        tmp_path_factory, "finished", lambda folder: train(tiny_config(folder, noisy_disc), device="cpu")
    )
    return folder / "runs" / "tiny"
