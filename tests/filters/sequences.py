"""Sequences for the filters' tests: a still room with noise, a step edge, light that changes."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from nte.denoiser import Denoiser
from nte.frames.frame import Frame
from nte.session import Session
from tests.synthetic import disc_frame

Pixels = npt.NDArray[np.float32]


def still_channels(size: tuple[int, int] = (24, 32), batch: int = 1) -> dict[str, Pixels]:
    """A disc before a wall in which nothing moves, without noise: channels (N, C, H, W), `reference` among them."""
    channels = disc_frame(0, size, velocity=(0.0, 0.0), start=(size[1] / 2, size[0] / 2), radius=min(size) / 4)
    return {name: np.repeat(values[None], batch, 0) for name, values in channels.items()}


def noisy_frames(count: int, channels: dict[str, Pixels], seed: int = 0) -> list[Frame]:
    """Frames of which `color` is `reference` times noise of mean 1 and variance 1."""
    rng = np.random.default_rng(seed)
    frames = []
    for index in range(count):
        noise = rng.exponential(size=(channels["color"].shape[0], 1, *channels["color"].shape[2:]))
        frames.append(Frame({**channels, "color": (channels["reference"] * noise).astype(np.float32)}, index))
    return frames


def run(denoiser: Denoiser, frames: Sequence[Frame]) -> list[Pixels]:
    """The images that the denoiser makes of a sequence."""
    session = Session(denoiser)
    return [session.denoise(frame) for frame in frames]
