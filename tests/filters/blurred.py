"""Blurred frames in closed form: a disc that moves before a wall at rest, every pixel at a time of its own."""

import numpy as np
import numpy.typing as npt

from nte.frames.frame import Frame
from tests.synthetic import smooth_texture

Pixels = npt.NDArray[np.float32]
DISC = np.array([3.0, 2.0, 1.0], np.float32)


def blurred_disc(
    index: int = 0, velocity: tuple[float, float] = (20.0, 0.0), size: tuple[int, int] = (48, 64), radius: float = 8.0,
    batch: int = 1, seed: int = 0, flat: bool = False,
) -> Frame:  # fmt: skip
    """The disc crosses the image's centre in the middle of frame 0's shutter. flat: without textures, wall 1."""
    rng = np.random.default_rng((seed, index + 100))
    shape = (batch, 1, *size)
    time = rng.random(shape)
    inside = covered(time, index, velocity, size, radius)
    x, y = _places(size)
    wall = np.ones((3, *size), np.float32) if flat else smooth_texture(x, y)
    moved = index + time[:, 0] - 0.5
    texture = smooth_texture(2 * (x - velocity[0] * moved), 2 * (y - velocity[1] * moved), 2.0).swapaxes(0, 1)
    disc = DISC[:, None, None] * (1 if flat else texture)
    channels = {
        "color": np.where(inside, disc, wall),
        "time": time,
        "shutter_motion": np.where(inside, np.reshape(velocity, (2, 1, 1)), 0.0),
        "shutter_depth": np.where(inside, 3.0, 5.0),
    }
    return Frame({name: np.broadcast_to(values, (batch, *values.shape[1:])).astype(np.float32)
                  for name, values in channels.items()}, index)  # fmt: skip


def covered(time: Pixels, index: int, velocity: tuple[float, float], size: tuple[int, int], radius: float) -> Pixels:
    """Whether the disc is in front of each pixel's centre at this time of frame `index`."""
    x, y = _places(size)
    centre = [size[1 - axis] / 2 + velocity[axis] * (index + time - 0.5) for axis in (0, 1)]
    return (x - centre[0]) ** 2 + (y - centre[1]) ** 2 < radius**2


def coverage(velocity: tuple[float, float], size: tuple[int, int] = (48, 64), radius: float = 8.0) -> Pixels:
    """(H, W): the share of frame 0's shutter in which the disc is in front of each pixel."""
    times = (np.arange(256) + 0.5) / 256
    return np.mean([covered(np.float32(t), 0, velocity, size, radius) for t in times], 0)


def _places(size: tuple[int, int]) -> tuple[Pixels, Pixels]:
    y, x = np.meshgrid(np.arange(size[0]) + 0.5, np.arange(size[1]) + 0.5, indexing="ij")
    return x.astype(np.float32), y.astype(np.float32)
