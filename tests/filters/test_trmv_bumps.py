"""Light from few directions on surfaces that are not flat: the clamp on history costs none of it."""

import numpy as np
import numpy.typing as npt
import pytest

from nte.filters.trmv import Trmv
from nte.filters.trmv.options import TrmvOptions
from nte.session import Session
from tests.filters.trmv_frames import plane

Array = npt.NDArray[np.float64]
SIZE = (30, 42)
FIRST, FRAMES = 14, 22


def bumps(frame: int, speed: tuple[float, float]) -> Array:
    """(3, H, W): unit normals of a wall with waves of 8 px that lean by 20° to each side, and slide at this speed."""
    y, x = np.meshgrid(np.arange(SIZE[0]) - speed[1] * frame, np.arange(SIZE[1]) - speed[0] * frame, indexing="ij")
    wave, lean = 2 * np.pi / 8, np.tan(np.radians(20))
    normal = np.stack([lean * np.sin(wave * (x + y / 2)), lean * np.cos(wave * (y - 0.3 * x)), np.ones(SIZE)])
    return np.asarray(normal / np.linalg.norm(normal, axis=0))


def directions(normal: Array, count: int, rng: np.random.Generator) -> Array:
    """(count, 3, H, W): cosine-weighted about each normal, one in each of as many rings of every pixel."""
    across = np.cross(normal, [1.0, 0, 0], axisa=0, axisc=0)
    across /= np.linalg.norm(across, axis=0)
    up = np.cross(normal, across, axis=0)
    rings = np.arange(count).reshape(-1, 1, 1)
    u = (rng.permuted(np.broadcast_to(rings, (count, *SIZE)), axis=0) + rng.random((count, *SIZE))) / count
    turn = 2 * np.pi * rng.random((count, *SIZE))
    circle = np.cos(turn)[:, None] * across + np.sin(turn)[:, None] * up
    return np.asarray(np.sqrt(u)[:, None] * circle + np.sqrt(1 - u)[:, None] * normal)


def lamp(direction: Array, towards: tuple[float, float, float], least: float) -> Array:
    """(…, 3, H, W): orange light from all directions whose cosine to `towards` is at least so large."""
    axis = np.reshape(towards, (3, 1, 1)) / np.linalg.norm(towards)
    lit = (direction * axis).sum(-3, keepdims=True) > least
    return np.asarray(lit * np.reshape([1, 0.5, 0.1], (3, 1, 1)))


@pytest.mark.parametrize(
    ("towards", "least", "speed"),
    [((0, 0, 1), 0.9, (0.0, 0.0)), ((0.9, 0.2, 0.4), 0.8, (0.0, 0.0)), ((0, 0, 1), 0.9, (1.0, 0.0))],
    ids=["along the wall's normal", "beside it", "on a wall that slides"],
)
def test_light_from_few_directions_keeps_its_energy_on_bumps(
    towards: tuple[float, float, float], least: float, speed: tuple[float, float]
) -> None:
    session, found, truth = Session(Trmv(TrmvOptions(target="indirect"))), [], []
    motion = -np.reshape(speed, (1, 2, 1, 1)) * np.ones((1, 2, *SIZE))
    for index in range(FRAMES):
        normal, rng = bumps(index, speed), np.random.default_rng([index, 3])
        direction = directions(normal, 1, rng)
        channels = {
            "normal": normal[None],
            "albedo": np.ones((1, 3, *SIZE)),
            "motion": motion,
            "previous_forward_motion": -motion,
            "indirect_direction": direction,
            "indirect_radiance": lamp(direction, towards, least),
        }
        frame = plane(index, SIZE, **{name: np.float32(values) for name, values in channels.items()})
        image = session.denoise(frame)
        if index >= FIRST:
            found.append(np.asarray(image).mean((0, 2, 3)))
            truth.append(lamp(directions(normal, 64, rng), towards, least).mean((0, 2, 3)))
    assert np.abs(np.mean(found, 0) / np.mean(truth, 0) - 1).max() < 0.025
