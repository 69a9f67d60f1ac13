"""A noisy scene of known light, for filters that accumulate it."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pytest

from nte.filters.accumulation import Surface
from nte.filters.change import in_blocks
from nte.frames.clip import Pixels

pyoidn = pytest.importorskip("pyoidn")

H, W = 60, 83  # no multiples of a block


class Scene(NamedTuple):
    """A slanted, coloured texture that moves under coloured light."""

    motion: tuple[float, float] = (0.0, 0.0)  # px a frame, of what is seen
    noise: float = 1.0  # standard deviation, relative to the light
    contrast: float = 1.0  # of the texture

    def clean(self, frame: int, light: float = 1.0) -> tuple[Pixels, Pixels]:
        """(color, albedo), each (3, H, W)."""
        y, x = np.mgrid[:H, :W] + 0.5
        u, v = x - frame * self.motion[0], y - frame * self.motion[1]
        stripes = 0.5 + 0.4 * self.contrast * np.sin(0.9 * u + 0.5 * v)
        albedo = np.stack([stripes, 0.3 + 0 * u, 1 - stripes])
        shade = light * (1 + 0.5 * np.sin(0.11 * u - 0.07 * v)) * np.array([1.0, 0.7, 0.4])[:, None, None]
        return np.float32(albedo * shade), np.float32(albedo)

    def noisy(self, clean: Pixels, seed: int) -> Pixels:
        shape = 1 / self.noise**2
        draws = np.random.default_rng(seed).gamma(shape, 1 / shape, (H, W))
        return np.float32(clean * draws)

    def surface(self, albedo: Pixels) -> Surface:
        motion = np.broadcast_to(-np.float32(self.motion)[:, None, None], (2, H, W)).copy()
        return Surface(albedo, motion, np.ones((1, H, W), np.float32), -motion)


def glance(albedo: Pixels | None = None) -> Callable[[Pixels], Pixels]:
    """What OIDN makes of a small image, quickly."""
    guides = [] if albedo is None else [interleaved(in_blocks(albedo))]
    return lambda blocks: by_oidn(interleaved(blocks), *guides, quality="fast", clean_aux=bool(guides))


def interleaved(image: Pixels) -> Pixels:
    return np.ascontiguousarray(image.transpose(1, 2, 0))


def by_oidn(*images: Pixels, **options: object) -> Pixels:
    return np.float32(pyoidn.denoise(*images, hdr=True, **options).transpose(2, 0, 1))


def error(image: Pixels, clean: Pixels, margin: int = 6) -> float:
    """The mean squared relative error of an image, without its border."""
    return float(np.square(image / clean - 1)[:, margin:-margin, margin:-margin].mean())
