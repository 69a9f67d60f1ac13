"""Moments, history length and the variance of SVGF: against a loop, and against what is known of noise."""

from collections.abc import Sequence

import pytest
import torch
from torch import Tensor

from nte.filters.moments import (
    brightness,
    estimated_variance,
    lengthen,
    running_mean_weight,
    shorten,
    variance_of,
    with_square,
)


def same_kind(p: Sequence[Tensor], q: Sequence[Tensor], distance: float) -> tuple[Tensor, Tensor]:
    """Pixels of one kind weigh 1; 0 is outside of the image and belongs to nobody."""
    same = ((p[0] == q[0]) & (p[0] > 0)).float()
    return same, same


@pytest.mark.parametrize("size", [(40, 70), (5, 3), (1, 1), (64, 32)])
def test_young_pixels_take_the_variance_of_their_surroundings(size: tuple[int, int]) -> None:
    random = torch.Generator().manual_seed(0)
    moments = with_square(torch.rand(2, 1, *size, generator=random))
    moments[:, 1] += 0.3
    kind = torch.randint(1, 3, (2, 1, *size), generator=random).float()
    length = torch.randint(1, 9, (2, 1, *size), generator=random).float()
    found = estimated_variance(moments, length, 4, same_kind, [kind])
    height, width = size
    for _ in range(20):
        n, y, x = (int(torch.randint(0, k, (1,), generator=random)) for k in (2, height, width))
        if length[n, 0, y, x] >= 4:
            assert float(found[n, 0, y, x]) == pytest.approx(0.3, abs=1e-5)
            continue
        around = (n, slice(None), slice(max(0, y - 3), y + 4), slice(max(0, x - 3), x + 4))
        alike = (kind[around] == kind[n, 0, y, x])[0]
        first, second = moments[around][:, alike].mean(1)
        expected = max(0.0, float(second - first**2)) * 4 / float(length[n, 0, y, x])
        assert float(found[n, 0, y, x]) == pytest.approx(expected, rel=1e-4, abs=1e-5)


def test_rounding_does_not_make_a_length_young() -> None:
    """A mean of lengths 4, weighted between four pixels, comes out as 3.9999998 or as 4."""
    moments, kind = with_square(torch.rand(1, 1, 5, 6)), torch.ones(1, 1, 5, 6)
    exact, rounded, less = (estimated_variance(moments, n * kind, 4, same_kind, [kind]) for n in (4, 4 - 1e-6, 3.99))
    assert torch.equal(exact, variance_of(moments))
    assert torch.equal(rounded, exact)
    assert (less > exact).all()


def test_only_tiles_with_young_pixels_are_computed() -> None:
    seen = 0

    def counting(p: Sequence[Tensor], q: Sequence[Tensor], distance: float) -> tuple[Tensor, Tensor]:
        nonlocal seen
        seen += p[0].numel()
        return same_kind(p, q, distance)

    moments, length = torch.rand(1, 2, 128, 128), torch.full((1, 1, 128, 128), 9.0)
    estimated_variance(moments, length, 4, counting, [length])
    assert seen == 0
    length[..., 50, 70] = 1
    estimated_variance(moments, length, 4, counting, [length])
    assert 0 < seen <= 24 * 38 * 38


def test_the_variance_over_time_is_that_of_the_noise() -> None:
    random = torch.Generator().manual_seed(0)
    moments = torch.zeros(1, 2, 64, 64)
    length = torch.zeros(1, 1, 64, 64)
    for _ in range(50):
        length = lengthen(length, torch.ones_like(length).bool(), 1000)
        sample = 3 + 0.5 * torch.randn(1, 1, 64, 64, generator=random)
        moments = torch.lerp(moments, with_square(sample), running_mean_weight(length, 0.001))
    assert float(variance_of(moments).mean()) == pytest.approx(0.25 * 49 / 50, rel=0.03)
    assert float(length.max()) == 50


def test_length_counts_to_its_limit_and_starts_anew_where_nothing_is_valid() -> None:
    length, valid = torch.tensor([1.0, 31, 32, 7]), torch.tensor([True, True, True, False])
    assert lengthen(length, valid, 32).tolist() == [2, 32, 32, 1]
    assert running_mean_weight(torch.tensor([1.0, 4, 100]), 0.05).tolist() == pytest.approx([1, 0.25, 0.05])


@pytest.mark.parametrize("change", [0.0, 0.1, 0.5, 0.93, 1.0])
def test_what_is_left_of_a_length_is_the_frames_that_the_weights_amount_to(change: float) -> None:
    for frames in range(1, 33):
        newest = 1 / frames + change * (1 - 1 / frames)
        weights = torch.cat([torch.tensor([newest]), torch.full((frames - 1,), (1 - newest) / max(1, frames - 1))])
        assert float(weights.sum()) == pytest.approx(1)
        left = float(shorten(torch.tensor(float(frames)), torch.tensor(change)))
        assert left == pytest.approx(1 / float(weights.square().sum()), rel=1e-4)
    if change == 0:
        assert left == pytest.approx(32, rel=1e-6)
    if change == 1:
        assert left == pytest.approx(1, rel=1e-6)


def test_brightness_is_luminance_of_a_colour_and_a_scalar_itself() -> None:
    assert float(brightness(torch.ones(1, 3, 1, 1))) == pytest.approx(1)
    scalar = torch.rand(1, 1, 2, 2)
    assert brightness(scalar) is scalar
