"""Light from few directions: cones give as much of it back as arrives, at rest, in motion and on turning surfaces."""

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import pytest

from nte.filters.trmv import Trmv
from nte.filters.trmv.options import TrmvOptions
from nte.frames.frame import Frame
from nte.session import Session
from tests.filters.trmv_frames import plane

Array = npt.NDArray[np.float64]
Light = Callable[[Array], Array]  # directions (…, 3) → radiance (…, 3)
SIZE = (36, 48)
WALL, SLANTED = np.array([0, 0, 1.0]), np.array([-0.4, 0.5, 0.768]) / np.linalg.norm([-0.4, 0.5, 0.768])
SLOPES = np.array([0, 0.5**0.5, 0.5**0.5]), np.array([0, -(0.5**0.5), 0.5**0.5])
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


def ridge(index: int, light: Light, speed: float) -> tuple[Frame, int]:
    """Two slopes that face each other's side at 90°, whose ridge moves down, and the first row of the lower one."""
    first = 10 + speed * index
    rows = np.arange(SIZE[0]) + 0.5
    normal = np.where(rows[:, None, None] < first, *SLOPES) + np.zeros((*SIZE, 3))
    sphere = np.random.default_rng([index, 3]).normal(size=normal.shape)
    direction = normal + 0.9999 * sphere / np.linalg.norm(sphere, axis=-1, keepdims=True)
    direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
    normal, direction, radiance = (v.transpose(2, 0, 1)[None] for v in (normal, direction, light(direction)))
    down = np.array([0, speed]).reshape(1, 2, 1, 1) + np.zeros((1, 2, *SIZE))
    channels = {
        "normal": normal,
        "albedo": np.ones_like(normal),
        "indirect": radiance,
        "indirect_radiance": radiance,
        "indirect_direction": direction,
        "motion": -down,
        "previous_forward_motion": down,
    }
    arrays = {name: np.asarray(values, np.float32) for name, values in channels.items()}
    return plane(index, SIZE, **arrays), int(np.ceil(first - 0.5))


@pytest.mark.parametrize("indirect", ["cones", "colour"])
@pytest.mark.parametrize("towards", [(0, 0, 1.0), (0, -0.9, 0.44)], ids=["both slopes", "one slope"])
def test_light_keeps_to_its_own_side_of_a_ridge_that_moves_by_parts_of_pixels(
    towards: tuple[float, float, float], indirect: str
) -> None:
    """Between pixels of both slopes, samples of one would be taken for those of directions in which they do not lie."""

    def lamp(direction: Array) -> Array:
        return np.repeat(direction @ np.array(towards)[:, None] > 0.85, 3, -1).astype(float)

    session, rows = Session(Trmv(TrmvOptions("indirect", indirect=indirect, clamp=float("inf")))), []  # type: ignore[arg-type]
    for index in range(36):
        frame, first = ridge(index, lamp, 0.37)
        image = np.asarray(session.step(frame).image)[0].mean((0, 2))
        rows.append(image[first - 2 : first + 2])
    truth = [lamp(stratified(90_000, normal, np.random.default_rng(1))).mean() for normal in SLOPES]
    np.testing.assert_allclose(np.mean(rows[20:], 0), np.repeat(truth, 2), atol=0.015)


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
