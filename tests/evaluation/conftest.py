"""A small noisy clip with two reference halves: a disc that moves before a wall."""

from pathlib import Path

import numpy as np
import pytest

from tests.synthetic import Pixels, disc_frame, write_clip


def noisy_frames(count: int, seed: int = 0, size: tuple[int, int] = (40, 56)) -> list[dict[str, Pixels]]:
    """Frames of the disc: colour with exponential noise, the reference's halves with a little of their own."""
    rng = np.random.default_rng(seed)
    frames = []
    for index in range(count):
        channels = disc_frame(index, size, start=(16.0, 20.0), rng=rng)
        truth = channels.pop("reference")
        for half in ("a", "b"):
            channels[f"reference_{half}"] = (truth * rng.normal(1, 0.02, truth.shape)).astype(np.float32)
        frames.append(channels)
    return frames


@pytest.fixture(scope="session")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four frames of 56×40, moving to the right."""
    return write_clip(tmp_path_factory.mktemp("clips") / "disc", noisy_frames(4))
