"""Synthetic bursts: a textured scene, sharp at every position, that moves by any fraction of a pixel under a sensor."""

from functools import cache

import numpy as np
import torch
from torch import Tensor

from nte.burst.mosaic import Mosaic
from nte.burst.noise import NoiseModel
from tests.burst.dng import BAYER, XTRANS

NOISE = NoiseModel(0.002, 1e-4)  # about ISO 3200 of a small sensor: 1 % in black, 3.3 % at half of white
PATTERNS = {"bayer": BAYER, "xtrans": XTRANS}


def mosaic_of(name: str) -> Mosaic:
    return Mosaic(tuple(tuple(row) for row in PATTERNS[name].tolist()))


@cache
def scene(
    size: tuple[int, int],
    shift: tuple[float, float] = (0, 0),
    disc: tuple[float, float] | None = None,
    radius: float = 12.0,
) -> Tensor:
    """(1, 3, H, W) in [0, 1], linear: waves of many periods from 6 px on, patches with edges, flat grounds.

    shift: (x, y) px that the scene has moved. disc: centre of a bright patterned disc in the shifted scene.
    """
    height, width = size
    x, y = np.arange(width) + 0.5 - shift[0], np.arange(height) + 0.5 - shift[1]
    rng = np.random.default_rng(7)
    light = np.full((3, height, width), 0.25)
    for _ in range(24):
        period, angle, phase = rng.uniform(6, 60), rng.uniform(0, np.pi), rng.uniform(0, 2 * np.pi)
        across, down = (np.exp(2j * np.pi / period * t) for t in (x * np.cos(angle), y * np.sin(angle)))
        wave = np.outer(down * np.exp(1j * phase), across).imag  # the sine of the sum, by a product: far faster
        light += 0.0012 * period * wave * rng.uniform(0.3, 1, (3, 1, 1)) / 2
    for _ in range(40):
        cx, cy, reach = rng.uniform(-20, width + 20), rng.uniform(-20, height + 20), rng.uniform(5, 18)
        columns, rows = (np.flatnonzero(abs(t - c) < reach + 10) for t, c in ((x, cx), (y, cy)))
        colour, part = rng.uniform(0.03, 0.7, (3, 1, 1)), np.ix_(range(3), rows, columns)
        inside = _soft(reach - np.maximum(abs(x[columns] - cx), abs(y[rows, None] - cy)))
        light[part] = light[part] * (1 - inside) + colour * inside
    x, y = np.meshgrid(x, y)
    if disc is not None:
        distance = np.hypot(x + shift[0] - disc[0], y + shift[1] - disc[1])
        stripes = 0.5 + 0.3 * np.sin((x + shift[0] - disc[0]) * 0.8)
        light = light * (1 - _soft(radius - distance)) + stripes * _soft(radius - distance)
    return torch.from_numpy(light.clip(0.01, 0.95).astype(np.float32))[None]


def _soft(distance: np.ndarray) -> np.ndarray:
    """Coverage of an edge as a lens shows it: 1.5 px wide."""
    return 1 / (1 + np.exp(-distance * 3))


def sense(image: Tensor, mosaic: Mosaic | None, noise: NoiseModel | None, seed: int) -> Tensor:
    """What a sensor makes of an image (1, 3, H, W): its mosaic (1, 1, H, W), if it has one, and its noise."""
    if mosaic is not None:
        image = image.gather(1, mosaic.colours(*image.shape[-2:])[None, None])
    if noise is None:
        return image
    unit = torch.randn(image.shape, generator=torch.Generator().manual_seed(seed))
    return image + noise.variance(image).sqrt() * unit


def psnr(image: Tensor, clean: Tensor, margin: int = 16) -> float:
    """dB with peak 1, without the border, where other frames have nothing to show."""
    error = (image - clean)[..., margin:-margin, margin:-margin].square().mean()
    return float(-10 * error.log10())
