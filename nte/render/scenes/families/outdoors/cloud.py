"""Clouds that drift and change their shape, and their shadows on the ground; motion vectors describe neither."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from nte.render.scenes import kit
from nte.render.scenes.family import Dice, between
from nte.render.scenes.patterns import bricks, dots, noise
from nte.render.scenes.solids import Size, block, sheet
from nte.render.world.scene import Material, Medium, Pixels, Scene, SceneObject
from nte.render.world.transforms import Floats, still

# The layer of air that holds the clouds: x, y and z. The cost of light in it grows with thickness times extinction:
# this layer renders three times as fast as one that is twice as deep and half as dense again.
_LAYER: Size = (13.0, 2.4, 2.4)
_FLOOR = (0.0, 2.2, 6.5)  # the middle of the layer's lower side
_CELLS = (20, 20, 104)  # z, y, x
_EXTINCTION = 3.0  # per scene unit, in the middle of a cloud
_LEAST_DEPTH = 10

Waves = npt.NDArray[np.complex128]


@dataclass
class Parameters:
    """cover: the share of the sky that clouds fill. speed: of the wind. change: the pace at which shapes change."""

    cover: float = between(0.45, 0.1, 0.9)
    speed: float = between(1.0, 0.0, 4.0)
    change: float = between(1.0, 0.0, 4.0)


def make_cloud(dice: Dice, parameters: Parameters) -> Scene:
    """Make fields up to the horizon, a row of cumulus clouds over them, and a sun behind the viewer and to the side.

    Clouds drift by 3 to 7 pixels per frame at 128 pixels.
    """
    wind = parameters.speed * dice.apart(0.2, 0.45) * dice.choice([-1, 1])
    air = _Air(dice, parameters, wind)
    unseen = Material(np.ones((1, 1, 3), np.float32), "none")
    layer = SceneObject(
        block(_LAYER, _FLOOR), unseen, still(), medium=Medium(_EXTINCTION, (1.0, 1.0, 1.0), 0.5, air.density)
    )
    grass = kit.textured(dice, kit.shades(dice.uniform(0.15, 0.3), 0.5, (0.6, 0.45, 0.3)), bricks, dots, noise)
    fields = kit.thing(sheet(90, 90, lambda x, z: 0.25 * np.sin(0.5 * x) * np.sin(0.4 * z + 1), 5.0), grass, still())
    sun = np.array([dice.uniform(16, 28) * dice.choice([-1, 1]), dice.uniform(18, 26), -10.0])
    light = kit.panel(3.0, 3.0, 12000.0, kit.aimed(kit.fixed(sun), (0, 3, 6)), (1.0, 0.94, 0.85))
    camera = kit.camera(kit.fixed((0, 1.2, -1.5)), kit.fixed((0, 2.9, 6.0)), 46)
    # The sky's own sun would be a second sun, so it is put below the horizon.
    return Scene((layer, fields, light), camera, kit.sky(dice, -sun, 0.3), _LEAST_DEPTH)


class _Air:
    """Noise of two sizes that repeats beyond the layer. Each drifts with a wind of its own, so shapes change."""

    def __init__(self, dice: Dice, parameters: Parameters, wind: float) -> None:
        self._waves = [_noise(dice, size) for size in (1.5, 0.5)]
        rise = 0.05 * parameters.change
        self._winds = [np.array([wind, 0.0, 0.0]), np.array([wind, rise, 0.8 * rise])]
        self._cover = parameters.cover

    def density(self, time: float) -> Pixels:
        """Return the density (Z, Y, X) at a time in frames, from 0 outside clouds to 1 in their middle."""
        large, small = (
            np.fft.ifftn(waves * _shift(wind * time)).real for waves, wind in zip(self._waves, self._winds, strict=True)
        )
        z, y, x = np.meshgrid(*(2 * (np.arange(n) + 0.5) / n - 1 for n in _CELLS), indexing="ij", sparse=True)
        profile = 1.8 * y**2 + 0.5 * y + 1.5 * (x**8 + y**8 + z**8)  # flat below, empty at the layer's sides
        filled = large + 0.35 * small + 2.2 * (self._cover - 0.5) - profile
        return np.clip(2 * filled, 0, 1).astype(np.float32)


def _noise(dice: Dice, size: float) -> Waves:
    """The spectrum of smooth noise of unit deviation whose features are `size` units large."""
    z, y, x = _frequencies()
    waves = np.fft.fftn(dice.normal(size=_CELLS)) * np.exp(-2 * (x**2 + y**2 + z**2) * size**2)
    waves[0, 0, 0] = 0  # no mean: the parameter `cover` decides how much is filled
    return np.asarray(waves / np.fft.ifftn(waves).real.std())


def _shift(offset: Floats) -> Waves:
    """The factors that move a spectrum by `offset` (3,), x, y and z, exactly and by any fraction of a cell."""
    z, y, x = _frequencies()
    return np.asarray(np.exp(-2j * np.pi * (x * offset[0] + y * offset[1] + z * offset[2])))


def _frequencies() -> list[Floats]:
    """Frequencies along z, y and x, in cycles per unit."""
    axes = [np.fft.fftfreq(n, length / n) for n, length in zip(_CELLS, _LAYER[::-1], strict=True)]
    return list(np.meshgrid(*axes, indexing="ij", sparse=True))
