"""One browser for all tests of the viewer, and a clip."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.evaluation.conftest import noisy_frames
from tests.synthetic import write_clip
from tests.viewer.browser import Browser
from tests.viewer.steering import WINDOW


@pytest.fixture(scope="session")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    found = Browser(tmp_path_factory.mktemp("profile"))
    found.size(*WINDOW)
    yield found
    found.close()


@pytest.fixture(scope="session")
def noisy_clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Five frames of 56×40 with a reference: a disc that moves to the right."""
    return write_clip(tmp_path_factory.mktemp("clips") / "disc", noisy_frames(5))
