"""Frames without a renderer: a disc before a wall, known in closed form, and random channels."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from nte.frames.clip import write_frame
from nte.frames.clip_files import frame_path
from nte.frames.clip_info import write_clip_info
from nte.frames.frame import Frame

Pixels = npt.NDArray[np.float32]
DISC, WALL = 2, 1


def smooth_texture(x: Pixels, y: Pixels, phase: float = 0.0) -> Pixels:
    """A colour (3, …) that varies over about 15 pixels: bilinear fetches of it are nearly exact."""
    waves = [np.sin(x * 0.31 + phase), np.sin(y * 0.27 + 1 + phase), np.sin((x + y) * 0.19 + 2 * phase)]
    return (0.5 + 0.4 * np.stack(waves)).astype(np.float32)


def disc_frame(
    index: int,
    size: tuple[int, int] = (48, 64),
    velocity: tuple[float, float] = (3.5, 0.0),
    wall_velocity: tuple[float, float] = (0.0, 0.0),
    start: tuple[float, float] = (20.0, 24.0),
    radius: float = 9.0,
    rng: np.random.Generator | None = None,
) -> dict[str, Pixels]:
    """Channels (C, H, W) of frame `index`: both surfaces carry their textures along with them."""
    height, width = size
    y, x = np.meshgrid(np.arange(height) + 0.5, np.arange(width) + 0.5, indexing="ij")
    shift, wall_shift = np.multiply(velocity, index), np.multiply(wall_velocity, index)
    centre = np.add(start, shift)
    disc = (x - centre[0]) ** 2 + (y - centre[1]) ** 2 < radius**2
    wall_albedo = smooth_texture(x - wall_shift[0], y - wall_shift[1])
    disc_albedo = smooth_texture(x - shift[0], y - shift[1], phase=2.0)
    speed = np.where(disc, np.reshape(velocity, (2, 1, 1)), np.reshape(wall_velocity, (2, 1, 1)))
    albedo = np.where(disc, disc_albedo, wall_albedo)
    tilt = np.where(disc, 0.6, 0.0)
    channels = {
        "albedo": albedo,
        "reference": 2 * albedo,
        "color": 2 * albedo,
        "normal": np.stack([tilt, 0 * tilt, np.sqrt(1 - tilt**2)]),
        "depth": np.where(disc, 3.0, 5.0)[None],
        "instance": np.where(disc, DISC, WALL)[None],
        "motion": -speed,
        "forward_motion": speed,
    }
    if rng is not None:
        channels["color"] = 2 * albedo * rng.exponential(size=(1, *size))
    return {name: values.astype(np.float32) for name, values in channels.items()}


def write_clip(folder: Path, frames: Sequence[dict[str, Pixels]], **info: object) -> Path:
    """A finished clip of these frames."""
    for i, channels in enumerate(frames):
        write_frame(frame_path(folder, i), channels)
    height, width = frames[0]["color"].shape[1:]
    write_clip_info(folder, {"width": width, "height": height, "frames": len(frames), **info})
    return folder


def disc_clip(folder: Path, frames: int = 4, seed: int | None = None, **options: object) -> Path:
    """A clip of the disc; with a seed its colour is noisy."""
    rng = None if seed is None else np.random.default_rng(seed)
    return write_clip(folder, [disc_frame(i, rng=rng, **options) for i in range(frames)])  # type: ignore[arg-type]


def random_channels(rng: np.random.Generator, size: tuple[int, int] = (24, 36), batch: int = 1) -> dict[str, Pixels]:
    """Everything a network takes, (N, C, H, W), plausible in range and without any structure."""
    shape = batch, 1, *size
    normal = rng.normal(size=(batch, 3, *size))
    motion = rng.normal(0, 2, (batch, 2, *size))
    channels = {
        "color": rng.exponential(size=(batch, 3, *size)),
        "albedo": rng.uniform(0.1, 0.9, (batch, 3, *size)),
        "normal": normal / np.linalg.norm(normal, axis=1, keepdims=True),
        "depth": np.where(rng.random(shape) < 0.1, 0, rng.uniform(2, 6, shape)),
        "motion": motion,
        "previous_forward_motion": np.where(rng.random(shape) < 0.2, 5.0, -motion),
    }
    return {name: values.astype(np.float32) for name, values in channels.items()}


def random_frames(count: int, size: tuple[int, int] = (24, 36), batch: int = 1, seed: int = 0) -> list[Frame]:
    """A sequence of frames of `random_channels`."""
    rng = np.random.default_rng(seed)
    return [Frame(random_channels(rng, size, batch), index) for index in range(count)]
