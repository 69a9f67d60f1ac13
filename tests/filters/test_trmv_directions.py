"""Light from few directions: cones give as much of it back as arrives, at rest, in motion and on turning surfaces."""

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import pytest

from nte.denoiser import Session
from nte.filters.trmv import Trmv
from nte.filters.trmv.options import TrmvOptions
from nte.frames.frame import Frame
from tests.filters.trmv_frames import plane

Array = npt.NDArray[np.float64]
Light = Callable[[Array], Array]  # directions (…, 3) → radiance (…, 3)
SIZE = (36, 48)
WALL, SLANTED = np.array([0, 0, 1.0]), np.array([-0.4, 0.5, 0.768]) / np.linalg.norm([-0.4, 0.5, 0.768])
TOWARDS = np.array([0.3, 0.5, 0.81]) / np.linalg.norm([0.3, 0.5, 0.81])  # where the lamp of `lobe` is


def tangents(normal: Array) -> tuple[Array, Array]:
    across = np.cross(normal, [1.0, 0, 0] if abs(normal[0]) < 0.8 else [0, 1.0, 0])
    across /= np.linalg.norm(across)
    return across, np.cross(normal, across)


def stratified(count: int, normal: Array, rng: np.random.Generator) -> Array:
    """(count, 3): cosine-weighted directions, one in each of as many cells of equal weight, in random order."""
    side = int(np.ceil(count**0.5))
    cell = rng.permutation(side * side)[:count]
    u, v = (cell % side + rng.random(count)) / side, (cell // side + rng.random(count)) / side
    across, up = tangents(normal)
    circle = np.cos(2 * np.pi * v)[:, None] * across + np.sin(2 * np.pi * v)[:, None] * up
    return np.sqrt(u)[:, None] * circle + np.sqrt(1 - u)[:, None] * normal


def along(normal: Array) -> Light:
    return lambda direction: np.repeat((direction @ normal > 0.9)[:, None], 3, 1).astype(float)


def grazing(normal: Array) -> Light:
    return lambda direction: np.repeat((direction @ normal < 0.3)[:, None], 3, 1).astype(float)


def coloured(normal: Array) -> Light:
    """Orange light from 60° beside the normal, at no axis of a cone, over a little that is blue."""
    across, up = tangents(normal)
    lamp = 0.5 * normal + 0.75**0.5 * (np.cos(2.0) * across + np.sin(2.0) * up)
    return lambda direction: (direction @ lamp > 0.9)[:, None] * np.array([1, 0.3, 0.05]) + [0.02, 0.02, 0.1]


def everywhere(normal: Array) -> Light:
    return lambda direction: np.ones_like(direction)


def lobe(normal: Array) -> Light:
    """Of a fixed direction of the world, some 30° wide."""
    return lambda direction: np.repeat(np.exp(8 * (direction @ TOWARDS - 1))[:, None], 3, 1)


def frame_of(index: int, normal: Array, light: Light, motion: float = 0.0) -> Frame:
    direction = stratified(SIZE[0] * SIZE[1], normal, np.random.default_rng([index, 7]))
    radiance = light(direction)
    image, towards = (values.T.reshape(1, 3, *SIZE) for values in (radiance, direction))
    channels = {
        "normal": np.broadcast_to(normal.reshape(1, 3, 1, 1), (1, 3, *SIZE)),
        "albedo": np.ones((1, 3, *SIZE)),
        "indirect": image,
        "indirect_radiance": image,
        "indirect_direction": towards,
        "motion": np.full((1, 2, *SIZE), motion),
        "previous_forward_motion": np.full((1, 2, *SIZE), -motion),
    }
    return plane(index, SIZE, **{name: np.asarray(values, np.float32) for name, values in channels.items()})


def bias(
    light: Callable[[Array], Light], turn: Callable[[int], Array], motion: float = 0.0, **options: object
) -> Array:
    """(3,): the mean of frames 18 … 25 over the truth, less 1."""
    session, found, truth = Session(Trmv(TrmvOptions("indirect", **options))), [], []  # type: ignore[arg-type]
    for index in range(26):
        normal = turn(index)
        image = session.step(frame_of(index, normal, light(normal), motion)).image
        if index >= 18:
            found.append(np.asarray(image).mean((0, 2, 3)))
            truth.append(light(normal)(stratified(90_000, normal, np.random.default_rng(1))).mean(0))
    return np.mean(found, 0) / np.mean(truth, 0) - 1


@pytest.mark.parametrize("clamp", [3.0, float("inf")])
@pytest.mark.parametrize("normal", [WALL, SLANTED], ids=["wall", "slanted"])
@pytest.mark.parametrize("light", [along, grazing, coloured, everywhere])
def test_at_rest_light_from_few_directions_keeps_its_energy(
    light: Callable[[Array], Light], normal: Array, clamp: float
) -> None:
    assert np.abs(bias(light, lambda _: normal, clamp=clamp)).max() < (1e-5 if light is everywhere else 0.01)


def test_so_does_it_on_a_surface_that_moves_by_parts_of_pixels() -> None:
    assert np.abs(bias(coloured, lambda _: SLANTED, motion=0.37)).max() < 0.01


def turning(degrees: float, about: tuple[float, float, float]) -> Callable[[int], Array]:
    """A wall that turns so much in each frame, and faces along z in frame 13."""
    axis = np.array(about) / np.linalg.norm(about)

    def normal(index: int) -> Array:
        angle = np.radians(degrees * (index - 13))
        return WALL * np.cos(angle) + np.cross(axis, WALL) * np.sin(angle) + axis * (axis @ WALL) * (1 - np.cos(angle))

    return normal


@pytest.mark.slow
@pytest.mark.parametrize("clamp", [3.0, float("inf")])
@pytest.mark.parametrize("about", [(1, 0, 0), (0, 1, 0.3)])
def test_a_wall_that_turns_slowly_lags_less_than_with_colours(about: tuple[float, float, float], clamp: float) -> None:
    turn = turning(1.0, about)
    assert np.abs(bias(lobe, turn, clamp=clamp)).max() < 0.05
    if clamp == float("inf"):
        colours = bias(lobe, turn, indirect="colour", clamp=clamp)
        assert np.abs(bias(lobe, turn, clamp=clamp)).max() < np.abs(colours).max()
