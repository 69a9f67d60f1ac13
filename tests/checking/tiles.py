"""Frames of a ground with a texture that repeats, seen by a camera at rest with one jittered sample in a pixel."""

import numpy as np
import numpy.typing as npt

from tests.synthetic import Pixels

SIZE = (72, 128)
FOCAL, HORIZON = 90.0, 14.0  # px
Floats = npt.NDArray[np.float64]


def _tile(u: Floats, v: Floats, kind: str) -> Floats:
    """Albedo (3, …) at places of the ground, with period 1 along both (checkers: 2)."""
    if kind == "checkers":
        dark = (np.floor(u) + np.floor(v)) % 2
        return np.stack([0.2 + 0.6 * dark, 0.3 + 0.4 * dark, 0.25 + 0.3 * dark])
    if kind == "bricks":
        joint = ((u + 0.5 * (np.floor(2 * v) % 2)) % 1 < 0.06) | ((2 * v) % 1 < 0.1)
        return np.where(joint, np.reshape([0.7, 0.7, 0.65], (3, 1, 1)), np.reshape([0.5, 0.2, 0.15], (3, 1, 1)))
    photo = np.random.default_rng(0).uniform(0.1, 0.9, (3, 16, 16))
    row, column = (np.floor((place % 1) * 16).astype(int) % 16 for place in (v, u))
    return photo[:, row, column]


def tiled_frame(index: int, kind: str, scale: float, seed: int = 0, ball: bool = True) -> dict[str, Pixels]:
    """Channels (C, H, W) of frame `index`: ground to the horizon, `scale` tiles a metre, and a moving disc."""
    rng = np.random.default_rng(100 * seed + index)
    y, x = np.mgrid[: SIZE[0], : SIZE[1]] + 0.5
    jittered = np.stack([x, y]) + rng.uniform(-0.5, 0.5, (2, *SIZE))
    centre, turn = 30 + 4 * index, 0.3

    def depth(y: Floats) -> Floats:
        down = (y - HORIZON) / FOCAL
        return np.where(down > 0.03, 1.5 / np.maximum(down, 0.03), 0)

    def inside(x: Floats, y: Floats) -> npt.NDArray[np.bool_]:
        return ((x - centre) ** 2 + (y - 40) ** 2 < 64) & ball

    far, right = depth(jittered[1]), depth(jittered[1]) * (jittered[0] - SIZE[1] / 2) / FOCAL
    u, v = (scale * (np.cos(a) * right + np.sin(a) * far) for a in (-turn, np.pi / 2 - turn))
    across = jittered[0] - centre
    waves = np.stack([np.sin(0.9 * across), np.sin(0.8 * jittered[1]), np.sin(0.5 * (across + jittered[1]))])
    albedo = np.where(inside(*jittered), 0.5 + 0.3 * waves, _tile(u, v, kind) * (far > 0))
    disc = inside(x, y)
    channels = {
        "color": albedo * rng.exponential(size=(1, *SIZE)),
        "albedo": albedo,
        "depth": np.where(disc, 1.6, depth(y))[None],
        "instance": np.where(disc, 2, depth(y) > 0)[None],
        "motion": np.where(disc, np.reshape([-4.0, 0], (2, 1, 1)), 0),
    }
    return {name: values.astype(np.float32) for name, values in channels.items()}
