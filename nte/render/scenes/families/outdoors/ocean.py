"""Open water: two trains of waves that reflect the sky. The surface deforms, and its foam moves with it."""

from dataclasses import dataclass, replace

import numpy as np

from nte.render.scenes import kit, shapes
from nte.render.scenes.family import Dice, between, switch
from nte.render.scenes.patterns import marble, noise
from nte.render.scenes.solids import placed, sheet
from nte.render.world.scene import DeformingObject, Material, Mesh, Scene, SceneObject
from nte.render.world.transforms import Floats, rotation, translation

_WIDTH, _DEPTH, _CELLS = 14.0, 50.0, 180


@dataclass
class Parameters:
    """height: of the waves. roughness: of the water. buoy: whether a buoy floats there."""

    height: float = between(0.22, 0.0, 0.5)
    roughness: float = between(0.12, 0.05, 0.5)
    buoy: bool = switch(True)


@dataclass(frozen=True)
class _Train:
    """A train of Gerstner waves: points move in circles, so crests are sharper than troughs."""

    direction: Floats  # (2,), unit, in x and z
    length: float
    height: float  # half of crest to trough
    rate: float  # radians per frame
    phase: float

    def offsets(self, x: Floats, z: Floats, time: float) -> Floats:
        """Return the offsets (N, 3) of the points that rest at x, z, at a time in frames."""
        angle = self._angle(x, z, time)
        along = self.height * np.cos(angle)
        return np.stack([along * self.direction[0], self.height * np.sin(angle), along * self.direction[1]], 1)

    def slopes(self, x: Floats, z: Floats, time: float) -> tuple[Floats, Floats]:
        """Return ∂height and ∂(offset along the direction), both by the way along the direction, each (N,)."""
        angle, pace = self._angle(x, z, time), 2 * np.pi / self.length * self.height
        return pace * np.cos(angle), -pace * np.sin(angle)

    def _angle(self, x: Floats, z: Floats, time: float) -> Floats:
        way = x * self.direction[0] + z * self.direction[1]
        return np.asarray(2 * np.pi / self.length * way - self.rate * time + self.phase)


def make_ocean(dice: Dice, parameters: Parameters) -> Scene:
    """Make a low sun in front of the camera, water up to the horizon, and a buoy that rides the waves."""
    trains = _trains(dice, parameters.height)
    water = _rest()
    foam = kit.textured(dice, np.array([[0.75, 0.8, 0.8], [0.05, 0.22, 0.28], [0.02, 0.1, 0.16]]), marble, noise)
    rest = water.positions.astype(float)
    wet = Material(foam, "glossy", parameters.roughness)
    objects: list[DeformingObject | SceneObject] = [
        DeformingObject(water, wet, lambda time: _surface(trains, rest, time))
    ]
    if parameters.buoy:
        place = np.array([[dice.uniform(-0.9, 0.9), 0.0, dice.uniform(-0.6, 0.8)]])
        paint = kit.textured(dice, kit.shades(dice.choice([0.0, 0.12]), 0.85, (0.9, 0.85, 0.4)))

        def riding(time: float) -> Floats:
            positions, normals = _surface(trains, place, time)
            lean = np.cross(kit.UP, normals[0])
            angle = float(np.linalg.norm(lean))
            return translation(positions[0]) @ rotation(lean if angle > 1e-9 else kit.UP, angle)

        buoy = placed(shapes.vase(dice), translation((0, 0.15, 0)), 0.45)
        objects.append(kit.thing(buoy, paint, riding, "glossy", 0.4))
    sun = (dice.uniform(-0.5, 0.5), dice.uniform(0.35, 0.6), 1.0)
    eye = kit.fixed((0, 1.7, -4.0))
    return Scene(tuple(objects), kit.camera(eye, kit.fixed((0, 0.1, 0.5)), 52), kit.sky(dice, sun))


def _trains(dice: Dice, height: float) -> tuple[_Train, _Train]:
    """Two trains that cross; short waves are lower and slower."""
    turn, rate = dice.uniform(-0.5, 0.5), dice.apart(0.25, 0.5)
    longer, shorter = dice.uniform(3.0, 4.2), dice.uniform(1.2, 1.8)
    other = turn + dice.choice([-1, 1]) * dice.uniform(0.9, 1.6)
    return (
        _Train(np.array([np.sin(turn), -np.cos(turn)]), longer, height, rate, dice.uniform(0, 6)),
        _Train(np.array([np.sin(other), -np.cos(other)]), shorter, 0.3 * height, 1.5 * rate, dice.uniform(0, 6)),
    )


def _rest() -> Mesh:
    """Flat water, with cells that are small near the camera and large towards the horizon."""
    flat = sheet(_WIDTH, _DEPTH, lambda x, z: 0 * x, texture_size=3.0, cells=_CELLS)
    far = flat.positions[:, 2] / _DEPTH + 0.5  # 0 near, 1 at the horizon
    positions = flat.positions.copy()
    positions[:, 0] *= 1 + 4 * far**2
    positions[:, 2] = -4.5 + _DEPTH * (0.2 * far + 0.8 * far**3)
    uv = (positions[:, [0, 2]] / 3.0).astype(np.float32)
    return replace(flat, positions=positions, uv=uv)


def _surface(trains: tuple[_Train, ...], rest: Floats, time: float) -> tuple[Floats, Floats]:
    """Positions and normals (N, 3) at a time of the points that rest at `rest` (N, 3)."""
    x, z = rest[:, 0], rest[:, 2]
    along_x, along_z = np.tile([1.0, 0.0, 0.0], (len(x), 1)), np.tile([0.0, 0.0, 1.0], (len(x), 1))
    positions = rest.copy()
    for train in trains:
        positions += train.offsets(x, z, time)
        up, forward = train.slopes(x, z, time)
        step = np.stack([forward * train.direction[0], up, forward * train.direction[1]], 1)
        along_x += step * train.direction[0]
        along_z += step * train.direction[1]
    normals = np.cross(along_z, along_x)
    return positions, normals / np.linalg.norm(normals, axis=1, keepdims=True)
