"""The frames of a benchmark, of any size: synthetic ones with every channel, or those of a clip, scaled."""

from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from nte.errors import NteError
from nte.frames.ahead import NEXT, with_next
from nte.frames.channels import CHANNELS, LP, Channel
from nte.frames.clip import Clip, Pixels
from nte.frames.frame import Frame

Source = Callable[[int], Frame]  # index → frame
SPEED = (3.5, 1.25)  # speed of the synthetic disc, in pixels per frame


def clip_frames(folder: Path, size: tuple[int, int] | None, channels: Iterable[str]) -> Source:
    """Read frames of a clip, with the named channels that it has; after the last frame it starts again.

    size: (height, width) to scale to, by the nearest pixel, with vectors in proportion; None keeps the clip's own.
    """
    clip = Clip(folder)
    asked = list(channels)
    wanted = [name for name in (*asked, *(NEXT[name] for name in asked if name in NEXT)) if name in clip.channels]

    def frame(index: int) -> Frame:
        read = (clip.frame(i % len(clip), wanted) for i in (index, index + 1))
        found = next(with_next(read, asked))
        return found if size in (None, found.size) else scaled(found, size)

    return frame


def scaled(frame: Frame, size: tuple[int, int]) -> Frame:
    """Scale a NumPy frame to `size` (height, width): each pixel takes the nearest one's values.

    Vectors and covariances are scaled in proportion.
    """
    rows, columns = ((np.arange(new) * 2 + 1) * old // (2 * new) for new, old in zip(size, frame.size, strict=True))
    across, down = size[1] / frame.size[1], size[0] / frame.size[0]
    factors = {"motion": (across, down), "covariance": (across * across, across * down, down * down)}

    def scale(name: str, values: Pixels) -> Pixels:
        kind = CHANNELS[name].kind if name in CHANNELS else ""
        factor = np.array(factors.get(kind, (1,)), np.float32).reshape(1, -1, 1, 1)
        return np.ascontiguousarray(values[:, :, rows[:, None], columns] * factor)

    channels = {name: scale(name, values) for name, values in frame.channels.items()}
    return replace(frame, channels=channels)


def synthetic_frames(size: tuple[int, int], channels: Iterable[str]) -> Source:
    """Make up frames of a disc that moves before a slanted wall under noisy light, with the named channels.

    Range, noise and occlusions are plausible, but the frames say nothing about quality. Names that the table of
    channels lacks are skipped. size: (height, width).
    """
    wanted = [CHANNELS[name] for name in channels if name in CHANNELS]
    height, width = size
    y, x = np.meshgrid(np.arange(height) + 0.5, np.arange(width) + 0.5, indexing="ij")

    def frame(index: int) -> Frame:
        rng = np.random.default_rng(index)
        centre = [(0.3 * extent + speed * index) % extent for extent, speed in zip((width, height), SPEED, strict=True)]
        disc = (x - centre[0]) ** 2 + (y - centre[1]) ** 2 < (min(size) / 4) ** 2
        made = {row.name: _made_up(row, disc, x / width, rng)[None].astype(np.float32) for row in wanted}
        for name in [row.name for row in wanted if row.components == LP]:  # one pixel of each stratum
            made[name][..., np.arange(height)[:, None] % 3 + 3 * (np.arange(width) % 3) != 4] = np.nan
        return Frame(made, index, clean_guides=True)

    return frame


def _made_up(
    row: Channel, disc: npt.NDArray[np.bool_], across: npt.NDArray[np.float64], rng: np.random.Generator
) -> npt.NDArray[np.float64]:
    """Values (C, H, W) of a channel, by its kind; noise for noisy channels."""
    shape = (len(row.components), *disc.shape)
    if row.kind == "depth":
        return np.where(disc, 3.0, 5.0 + across)[None]
    if row.kind == "id":
        return np.where(disc, 2.0, 1.0)[None]
    if row.kind == "motion":
        sign = 1 if "forward" in row.name else -1
        return np.where(disc, np.reshape(SPEED, (2, 1, 1)) * np.float64(sign), 0)
    if row.kind == "direction":
        drawn = rng.normal(size=shape) if row.noisy else np.broadcast_to(np.reshape([0, 0, 1.0], (3, 1, 1)), shape)
        facing = np.stack([drawn[0], drawn[1], np.abs(drawn[2]) + 1e-3])
        return np.asarray(facing / np.linalg.norm(facing, axis=0))
    if row.kind == "radiance":
        return rng.exponential(size=shape) if row.noisy else np.broadcast_to(1 + across, shape)
    if row.kind == "scalar" and row.name == "visibility":
        return (rng.random(shape) < 0.5).astype(float)
    return np.broadcast_to(0.2 + 0.6 * across, shape)


def source_of(clip: Path | None, size: tuple[int, int], channels: Iterable[str]) -> Source:
    """Choose the frames: those of the clip, scaled to `size` (height, width), or synthetic ones without a clip.

    Raises NteError for a size without pixels, and for a clip that cannot be read.
    """
    if min(size) < 1:
        raise NteError(f"size is {size[1]}x{size[0]}, expected at least 1x1")
    return synthetic_frames(size, channels) if clip is None else clip_frames(clip, size, channels)
