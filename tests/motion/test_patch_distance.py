"""One level of the patch search, against a slow obvious twin and cases whose answer is known."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from nte.motion import patch_distance
from nte.motion.patch_distance import NORMS, REACH, Norm, best_shift


def per_pixel(a: Tensor, b: Tensor, norm: str) -> Tensor:
    difference = (a - b).square().mean(0) if norm == "l2" else (a - b).abs().mean(0)
    return torch.log(2 + difference) if norm.startswith("log") else difference


def table_of(current: Tensor, previous: Tensor, radius: int, norm: str) -> Tensor:
    """(5, 5, H, W): the distance under every shift, pixel by pixel of the patch, in float64."""
    current, previous = current.double(), previous.double()
    _, height, width = current.shape
    table = torch.zeros(5, 5, height, width, dtype=torch.float64)
    for sy in range(-REACH, REACH + 1):
        for sx in range(-REACH, REACH + 1):
            ys = (torch.arange(height) + sy).clamp(0, height - 1)
            xs = (torch.arange(width) + sx).clamp(0, width - 1)
            distance = per_pixel(current, previous[:, ys][:, :, xs], norm)
            for y in range(height):
                for x in range(width):
                    rows = slice(max(y - radius, 0), y + radius + 1)
                    columns = slice(max(x - radius, 0), x + radius + 1)
                    table[sy + REACH, sx + REACH, y, x] = distance[rows, columns].mean()
            if norm == "log_centred":
                table[sy + REACH, sx + REACH] *= 2 - math.exp(-0.02 * (sx * sx + sy * sy))
    return table


def images(seed: int, channels: int = 1, size: tuple[int, int] = (11, 13)) -> tuple[Tensor, Tensor]:
    made = np.random.default_rng(seed).random((2, 1, channels, *size), dtype=np.float32)
    return torch.from_numpy(made[0]), torch.from_numpy(made[1])


@pytest.mark.parametrize("norm", NORMS)
@pytest.mark.parametrize(("radius", "channels"), [(0, 1), (1, 3), (2, 1), (6, 2)])
def test_the_least_of_25_distances_as_a_slow_twin_finds_it(norm: Norm, radius: int, channels: int) -> None:
    current, previous = images(radius, channels)
    shift, distance = best_shift(current, previous, radius, norm, refine=False)
    table = table_of(current[0], previous[0], radius, norm)
    least = table.flatten(0, 1).amin(0)
    x, y = shift[0].long() + REACH
    rows, columns = torch.meshgrid(torch.arange(11), torch.arange(13), indexing="ij")
    chosen = table[y, x, rows, columns]
    assert (chosen - least).max() < 1e-5  # several may be as good: rounding decides
    floor = math.log(2) if norm.startswith("log") else 0.0
    weight = 2 - torch.exp(-0.02 * shift[0].double().square().sum(0)) if norm == "log_centred" else 1.0
    assert (distance[0, 0] - (chosen / weight - floor)).abs().max() < 1e-5


def test_refinement_adds_the_minimum_of_a_weighted_quadric() -> None:
    current, previous = images(3)
    whole, _ = best_shift(current, previous, 2, "l2", refine=False)
    fine, _ = best_shift(current, previous, 2, "l2", refine=True)
    table = table_of(current[0], previous[0], 2, "l2").numpy()
    places = [(x, y) for y in (-1, 0, 1) for x in (-1, 0, 1)]
    terms = np.array([[x * x / 2, x * y, y * y / 2, x, y, 1] for x, y in places], float)
    weights = np.sqrt([(2 - abs(x)) * (2 - abs(y)) for x, y in places])
    checked = 0
    for y in range(whole.shape[2]):
        for x in range(whole.shape[3]):
            sx, sy = (int(v) for v in whole[0, :, y, x])
            if max(abs(sx), abs(sy)) == REACH:
                assert torch.equal(fine[0, :, y, x], whole[0, :, y, x])  # the 3×3 leaves the table
                continue
            values = np.array([table[sy + dy + REACH, sx + dx + REACH, y, x] for dx, dy in places])
            xx, xy, yy, to_x, to_y, _ = np.linalg.lstsq(terms * weights[:, None], values * weights, rcond=None)[0]
            if xx <= 0.01 or yy <= 0.01 or xx * yy - xy * xy <= 0.001:
                continue
            expected = np.clip(-np.linalg.solve([[xx, xy], [xy, yy]], [to_x, to_y]), -1, 1)
            np.testing.assert_allclose((fine - whole)[0, :, y, x].numpy(), expected, atol=2e-2)
            checked += 1
    assert checked > 10


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 1000), radius=st.integers(0, 9), norm=st.sampled_from(NORMS), batch=st.integers(1, 2))
def test_strips_change_nothing(seed: int, radius: int, norm: Norm, batch: int) -> None:
    current, previous = (image.repeat(batch, 1, 1, 1) for image in images(seed, size=(70, 9)))
    whole = best_shift(current, previous, radius, norm, refine=True)
    plane = patch_distance._PLANE
    try:
        patch_distance._PLANE = 1  # strips of 16 rows, or of the radius
        strips = best_shift(current, previous, radius, norm, refine=True)
    finally:
        patch_distance._PLANE = plane
    assert torch.equal(whole[0], strips[0])
    assert torch.equal(whole[1], strips[1])


@pytest.mark.parametrize("norm", NORMS)
@pytest.mark.parametrize("value", [0.0, 0.7])
def test_constant_images_stand_still_and_are_equal(norm: Norm, value: float) -> None:
    image = torch.full((1, 1, 20, 24), value)
    shift, distance = best_shift(image, image, 2, norm, refine=True)
    assert not shift.any()
    assert distance.max() <= 1e-5


@pytest.mark.parametrize("norm", NORMS)
@pytest.mark.parametrize(("dx", "dy"), [(1, 0), (-2, 1), (2, -2)])
def test_a_shifted_image_is_found(norm: Norm, dx: int, dy: int) -> None:
    large, _ = images(5, size=(40, 44))
    current, previous = large[..., 4:36, 4:40], large[..., 4 - dy : 36 - dy, 4 - dx : 40 - dx]
    shift, distance = best_shift(current, previous, 2, norm, refine=True)
    inner = (slice(None), slice(None), slice(5, -5), slice(5, -5))
    assert (shift[inner] == torch.tensor([dx, dy]).view(1, 2, 1, 1)).all()  # a perfect match is not refined
    assert distance[inner].max() <= 1e-5
