"""À-trous filtering: against a loop over pixels, and what edge-stopping weights are for."""

from collections.abc import Sequence

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from nte.filters import atrous
from nte.filters.atrous import B3_SPLINE, atrous_step


def everywhere(p: Sequence[Tensor], q: Sequence[Tensor], distance: float) -> tuple[Tensor, Tensor]:
    """No edges: every weight is 1."""
    one = torch.ones_like(p[0][:, :1])
    return one, one


def lopsided(p: Sequence[Tensor], q: Sequence[Tensor], distance: float) -> tuple[Tensor, Tensor]:
    """Weights that depend on both ends, the distance, and on which end asks."""
    apart = (p[0] - q[0]).abs() / distance
    return torch.exp(-apart * p[1]), torch.exp(-apart * q[1])


def slow(
    values: Tensor, step: int, guides: Sequence[Tensor], variance: Tensor, kernel: Sequence[float]
) -> list[Tensor]:
    """The definition, pixel by pixel and tap by tap."""
    mean, spread = torch.zeros_like(values), torch.zeros_like(variance)
    batch, _, height, width = values.shape
    reach = len(kernel) - 1
    taps = [(y, x) for y in range(-reach, reach + 1) for x in range(-reach, reach + 1)]
    for n in range(batch):
        for y in range(height):
            for x in range(width):
                total = 0.0
                for dy, dx in taps:
                    v, u = y + dy * step, x + dx * step
                    if not (0 <= v < height and 0 <= u < width):
                        continue
                    weight = kernel[abs(dy)] * kernel[abs(dx)]
                    if (dy, dx) != (0, 0):
                        ends = [[g[n : n + 1, :, j : j + 1, i : i + 1] for g in guides] for j, i in ((y, x), (v, u))]
                        weight *= float(lopsided(ends[0], ends[1], step * (dx * dx + dy * dy) ** 0.5)[0])
                    total += weight
                    mean[n, :, y, x] += weight * values[n, :, v, u]
                    spread[n, :, y, x] += weight**2 * variance[n, :, v, u]
                mean[n, :, y, x] /= total
                spread[n, :, y, x] /= total**2
    return [mean, spread]


@settings(max_examples=20, deadline=None)
@given(
    st.tuples(st.integers(1, 2), st.integers(1, 4), st.integers(1, 9), st.integers(1, 9)),
    st.sampled_from((1, 2, 4)),
    st.sampled_from((B3_SPLINE, (1.0, 1.0), (1.0, 0.9, 0.5, 0.2))),
    st.sampled_from((1, 20, 1000)),
    st.sampled_from((1, 2, 3)),
    st.integers(0, 9),
)
def test_it_is_the_sum_over_taps_however_it_is_cut_into_strips_and_bands(
    shape: tuple[int, int, int, int], step: int, kernel: Sequence[float], strip: int, threads: int, seed: int
) -> None:
    random = torch.Generator().manual_seed(seed)
    values, variance = (torch.rand(shape, generator=random) for _ in range(2))
    guides = [torch.rand((shape[0], 1, *shape[2:]), generator=random) for _ in range(2)]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(atrous, "STRIP_PIXELS", strip)
        patch.setattr(atrous, "threads_for", lambda tensor: threads)
        filtered = atrous_step(values, step, lopsided, guides, variance, kernel)
    mean, spread = slow(values, step, guides, variance, kernel)
    torch.testing.assert_close(filtered.values, mean)
    torch.testing.assert_close(filtered.variance, spread)


def test_levels_widen_the_kernel_and_an_impulse_spreads_as_the_b3_spline() -> None:
    image = torch.zeros(1, 1, 33, 33)
    image[..., 16, 16] = 1
    once = atrous_step(image, 1, everywhere, [image]).values[0, 0, 16, 12:21]
    torch.testing.assert_close(once, torch.tensor([0, 0, 1, 4, 6, 4, 1, 0, 0]) / 16 * 6 / 16)
    for step in (1, 2, 4):
        image = atrous_step(image, step, everywhere, [image]).values
    assert (image[0, 0, 16] > 0).nonzero()[[0, -1], 0].tolist() == [2, 30]  # 2 · (1 + 2 + 4) to both sides


def test_the_variance_is_that_of_the_mean_of_independent_noise() -> None:
    noise = torch.randn(64, 1, 32, 32, generator=torch.Generator().manual_seed(0))
    filtered = atrous_step(noise, 2, everywhere, [noise], torch.ones_like(noise))
    inner = (slice(None), slice(None), slice(4, -4), slice(4, -4))
    assert filtered.values[inner].var() == pytest.approx(float(filtered.variance[inner].mean()), rel=0.05)


def test_a_constant_stays_and_nothing_crosses_an_edge_of_weight_zero() -> None:
    side = (torch.arange(20) >= 9).float().expand(1, 1, 7, 20).contiguous()

    def walled(p: Sequence[Tensor], q: Sequence[Tensor], distance: float) -> tuple[Tensor, Tensor]:
        same = (p[0] == q[0]).float()
        return same, same

    values = torch.cat([side * 3 + 1, torch.full_like(side, 5)], 1)
    for step in (1, 2, 4, 16):
        torch.testing.assert_close(atrous_step(values, step, walled, [side]).values, values)
