"""Procedural textures: periodic bitmaps with soft edges and with features that survive reprojection.

Every pattern has four periods in its bitmap, so a texture that covers 4 scene units has features of about half a unit.
Edges are soft, because bilinear reprojection of a hard edge has an error of half its contrast.
"""

import colorsys
from collections.abc import Callable

import numpy as np

from nte.render.world.scene import Pixels
from nte.render.world.transforms import Floats

SIZE = 128  # texels per side
PERIODS = 4
_SOFT = 0.08  # width of an edge, as a share of a period

Pattern = Callable[[np.random.Generator], Floats]  # → (SIZE, SIZE, 3) weights of three colours, sum 1


def random_texture(rng: np.random.Generator) -> Pixels:
    """Make a random pattern in random colours: (SIZE, SIZE, 3), linear reflectance in [0.05, 0.9]."""
    weights = PATTERNS[rng.integers(len(PATTERNS))](rng)
    return (weights @ palette(rng)).astype(np.float32)


def plain(rng: np.random.Generator) -> Pixels:
    """Make a texture (1, 1, 3) of one random colour."""
    return palette(rng)[:1, None].astype(np.float32)


def palette(rng: np.random.Generator) -> Floats:
    """Make three colours (3, 3) that differ in hue or in lightness, linear."""
    hue = rng.uniform()
    hues = hue + rng.choice([0.03, 0.15, 0.33, 0.5]) * np.array([0, 1, 2])
    saturation = rng.uniform(0.15, 0.8, 3)
    value = rng.permutation([rng.uniform(0.2, 0.4), rng.uniform(0.4, 0.7), rng.uniform(0.7, 0.9)])
    return np.array([colorsys.hsv_to_rgb(h % 1, s, v) for h, s, v in zip(hues, saturation, value, strict=True)])


def stripes(rng: np.random.Generator) -> Floats:
    """Draw bands of two colours along one axis or the diagonal, every other band in the third colour."""
    x, y = _grid()
    along = [x, y, x + y][rng.integers(3)]
    return _mix(_wave(along), _wave(along / 2))


def checker(rng: np.random.Generator) -> Floats:
    """Draw a chessboard, with larger squares of the third colour behind it."""
    x, y = _grid()
    a, b = _wave(x), _wave(y)
    return _mix(a * b + (1 - a) * (1 - b), _wave(x / 4 + 0.1) * 0.7)


def bricks(rng: np.random.Generator) -> Floats:
    """Draw rows of bricks or planks, each in a shade of its own, with joints between them."""
    x, y = _grid()
    rows, length = int(rng.choice([4, 8])), int(rng.choice([2, 4]))
    row = np.floor(y * rows / PERIODS).astype(int)
    shifted = x * length / PERIODS + 0.5 * (row % 2)
    shade = rng.uniform(size=(rows, length))[row % rows, np.floor(shifted).astype(int) % length]
    joint = np.minimum(_edge_distance(shifted) * PERIODS / length, _edge_distance(y * rows / PERIODS) * PERIODS / rows)
    return _mix(1 - _smooth((joint - 0.03) / _SOFT), shade)


def noise(rng: np.random.Generator) -> Floats:
    """Draw smooth clouds of three colours."""
    return _mix(_smooth(_clouds(rng, 0.45) * 0.8 + 0.5), _smooth(_clouds(rng, 0.8) * 0.8 + 0.5))


def dots(rng: np.random.Generator) -> Floats:
    """Draw round spots on a clouded ground."""
    x, y = _grid()
    distance = np.hypot(_fold(x), _fold(y))
    return _mix(1 - _smooth((distance - rng.uniform(0.22, 0.34)) / _SOFT + 0.5), _smooth(_clouds(rng, 0.8) + 0.5))


def marble(rng: np.random.Generator) -> Floats:
    """Draw wavy veins."""
    x, _ = _grid()
    veins = 0.5 + 0.5 * np.sin(2 * np.pi * (x + 0.6 * _clouds(rng, 0.9)))
    return _mix(veins, _smooth(_clouds(rng, 0.6) + 0.3))


PATTERNS: tuple[Pattern, ...] = (stripes, checker, bricks, noise, dots, marble)


def _grid() -> tuple[Floats, Floats]:
    """x and y of the texel centres, in periods."""
    axis = (np.arange(SIZE) + 0.5) / SIZE * PERIODS
    x, y = np.meshgrid(axis, axis)
    return x, y


def _mix(first: Floats, second: Floats) -> Floats:
    """Weights of three colours: `first` chooses colour 0; `second` divides the rest between colours 1 and 2."""
    return np.stack([first, (1 - first) * second, (1 - first) * (1 - second)], axis=-1)


def _fold(x: Floats) -> Floats:
    """Signed distance to the nearest middle of a period, in [−0.5, 0.5]."""
    return x - np.floor(x) - 0.5


def _edge_distance(x: Floats) -> Floats:
    """Distance to the nearest whole number."""
    return 0.5 - np.abs(_fold(x))


def _wave(x: Floats) -> Floats:
    """A soft square wave of period 1, in [0, 1]."""
    return _smooth((0.25 - np.abs(_fold(x))) / _SOFT + 0.5)


def _smooth(x: Floats) -> Floats:
    t = np.clip(x, 0, 1)
    return t * t * (3 - 2 * t)


def _clouds(rng: np.random.Generator, scale: float) -> Floats:
    """Periodic band-limited noise of unit deviation. scale: size of its features, in periods."""
    frequency = np.fft.fftfreq(SIZE, 1 / SIZE)
    sigma = PERIODS / (2 * np.pi * scale) * 1.5
    window = np.exp(-(frequency[:, None] ** 2 + frequency**2) / (2 * sigma**2))
    field = np.fft.ifft2(np.fft.fft2(rng.normal(size=(SIZE, SIZE))) * window).real
    return np.asarray((field - field.mean()) / field.std(), float)
