"""Frames for TRMV without a renderer: a lit plane or a ball, with every channel that the filter reads."""

from typing import Any

import numpy as np
import numpy.typing as npt

from nte.frames.frame import Frame

Pixels = npt.NDArray[np.float32]


def directions(rng: np.random.Generator, normal: Pixels) -> Pixels:
    """Cosine-weighted directions (N, 3, H, W) about the normals."""
    sphere = rng.normal(size=normal.shape)
    sphere /= np.linalg.norm(sphere, axis=1, keepdims=True)
    found = normal + 0.999 * sphere
    return (found / np.linalg.norm(found, axis=1, keepdims=True)).astype(np.float32)


def ball_normals(size: tuple[int, int]) -> Pixels:
    """(1, 3, H, W): of a ball that fills the image, and of the wall behind it."""
    height, width = size
    y, x = np.meshgrid(np.linspace(-1.1, 1.1, height), np.linspace(-1.1, 1.1, width), indexing="ij")
    z = np.sqrt(np.clip(1 - x**2 - y**2, 0, None))
    normal = np.where(z > 0.1, np.stack([x, y, z]), np.array([0, 0, 1.0]).reshape(3, 1, 1))
    return (normal / np.linalg.norm(normal, axis=0))[None].astype(np.float32)


def plane(index: int = 0, size: tuple[int, int] = (20, 28), seed: int = 0, batch: int = 1, **given: Any) -> Frame:
    """A plane at rest that faces the camera, with fresh noise in each frame; `given` replaces channels (N, C, H, W).

    Its light: half of the shadow rays blocked, indirect radiance exponential about 1, glossy light likewise.
    """
    rng = np.random.default_rng([seed, index])
    shape = (batch, 1, *size)

    def full(*values: float) -> Pixels:
        return np.broadcast_to(np.reshape(values, (1, -1, 1, 1)), (batch, len(values), *size)).astype(np.float32)

    y, x = np.meshgrid(np.arange(size[0]) + 0.5, np.arange(size[1]) + 0.5, indexing="ij")
    normal = given.get("normal", full(0, 0, 1))
    direction = directions(rng, normal) * (rng.random(shape) < 0.8)
    channels = {
        "normal": normal,
        "depth": full(5),
        "position": np.stack([x, y, 0 * x])[None].repeat(batch, 0) * 0.1,
        "roughness": full(0.3),
        "motion": full(0, 0),
        "previous_forward_motion": full(0, 0),
        "albedo": full(0.2, 0.5, 0.8),
        "emission": full(0, 0, 0),
        "direct": full(1, 2, 3),
        "visibility": rng.random(shape) < 0.5,
        "indirect": rng.exponential(size=shape) * full(0.2, 0.5, 0.8),
        "indirect_radiance": rng.exponential(size=shape) * (direction != 0).any(1, keepdims=True) * full(1, 1, 1),
        "indirect_direction": direction,
        "glossy": rng.exponential(size=(batch, 3, *size)),
        "reflection_motion": full(0, 0),
        "reflection_covariance": full(0, 0, 0),
    }
    stratum = np.arange(size[0])[:, None] % 3 + 3 * (np.arange(size[1]) % 3)
    channels["gradient"] = np.where(stratum == 4, full(1, 1), np.nan)
    channels["shadow_motion"] = np.where(channels["visibility"] < 1, full(0, 0), np.nan)
    return Frame({name: np.asarray(values, np.float32) for name, values in (channels | given).items()}, index)
