"""Separable joint bilateral filters against loops over pixels."""

import math

import pytest
import torch
from hypothesis import example, given, settings
from hypothesis import strategies as st
from torch import Tensor

from nte.filters.bilateral import (
    APART,
    CLEAN_UP_RADIUS,
    DEPTH,
    NORMAL,
    ROUGHNESS,
    Edges,
    Guide,
    clean_up,
    joint_bilateral,
    make_edges,
    make_guide,
)


def random_surface(height: int, width: int, seed: int) -> tuple[Tensor, Tensor, Tensor]:
    """Normal, depth and roughness that vary enough to stop a filter here and there, with some sky."""
    generator = torch.Generator().manual_seed(seed)
    bumps = 0.1 * torch.randn(2, 3, height, width, generator=generator)
    normal = torch.tensor([0.0, 0.0, 1.0]).view(1, 3, 1, 1) + bumps
    depth = 4 + 0.05 * torch.randn(2, 1, height, width, generator=generator)
    sky = torch.rand(2, 1, height, width, generator=generator) < 0.1
    roughness = 0.5 + 0.05 * torch.randn(2, 1, height, width, generator=generator)
    return torch.nn.functional.normalize(normal, dim=1) * ~sky, depth * ~sky, roughness


def slow_weight(normal: Tensor, depth: Tensor, roughness: Tensor, p: tuple[int, int], q: tuple[int, int]) -> float:
    """The formula of `pair_weight`'s docstring, for pixels p and q of one image (C, H, W) on one row or column."""
    cosine = float(normal[:, *p] @ normal[:, *q])
    lengths = float(normal[:, *p] @ normal[:, *p] + normal[:, *q] @ normal[:, *q]) / 2
    z, z_there = float(depth[0, *p]), float(depth[0, *q])
    rough = float(roughness[0, *p] - roughness[0, *q])
    exponent = NORMAL * (cosine - lengths) - 0.5 * (rough / ROUGHNESS) ** 2
    if (z > 0) != (z_there > 0):
        return 0.0
    if z > 0:
        axis = 0 if p[1] == q[1] else 1
        slope = (slow_slope(depth[0], p, axis) + slow_slope(depth[0], q, axis)) / 2
        unexplained = 1 / z_there - 1 / z - (q[axis] - p[axis]) * slope
        exponent -= 0.5 * unexplained**2 * z * z_there / DEPTH**2
    weight = math.exp(exponent)
    return weight if weight > APART else 0.0


def slow_slope(depth: Tensor, p: tuple[int, int], axis: int) -> float:
    """The smaller of the differences of 1/z to both neighbours on the same side of the sky's edge.

    It is at most four times the one that follows it on that side.
    """

    def step(at: tuple[int, int], sign: int) -> float | None:
        q = (at[0] + sign, at[1]) if axis == 0 else (at[0], at[1] + sign)
        if not 0 <= q[axis] < depth.shape[axis] or (float(depth[*q]) > 0) != (float(depth[*at]) > 0):
            return None
        here, there = (1 / float(depth[*one]) if float(depth[*one]) > 0 else 0.0 for one in (at, q))
        return sign * (there - here)

    steps = [(found, sign) for sign in (-1, 1) if (found := step(p, sign)) is not None]
    if not steps:
        return 0.0
    smaller, sign = min(steps, key=lambda found: abs(found[0]))
    following = step((p[0] + sign, p[1]) if axis == 0 else (p[0], p[1] + sign), sign)
    most = math.inf if following is None else 4 * abs(following)
    return math.copysign(min(abs(smaller), most), smaller)


def slow_bilateral(values: Tensor, surface: tuple[Tensor, ...], radius: int, deviation: Tensor) -> Tensor:
    for axis in (1, 0):
        result = torch.zeros_like(values)
        for n in range(values.shape[0]):
            for y in range(values.shape[2]):
                for x in range(values.shape[3]):
                    total, norm = values[n, :, y, x].clone(), 1.0
                    for k in [*range(-radius, 0), *range(1, radius + 1)]:
                        q = (y + k, x) if axis == 0 else (y, x + k)
                        sigma = float(deviation[n, 0, y, x])
                        if sigma > 0 and 0 <= q[axis] < values.shape[2 + axis]:
                            edge = slow_weight(*(guide[n] for guide in surface), (y, x), q)
                            weight = edge * math.exp(-0.5 * (k / sigma) ** 2)
                            total += weight * values[n, :, *q]
                            norm += weight
                    result[n, :, y, x] = total / norm
        values = result
    return values


@settings(max_examples=8, deadline=None)
@example(1, 6, 3, 0, False)  # a surface between two pixels of sky
@given(st.integers(1, 7), st.integers(1, 7), st.integers(1, 4), st.integers(0, 100), st.booleans())
def test_it_is_the_loop_over_pixels(height: int, width: int, radius: int, seed: int, per_pixel: bool) -> None:
    surface = random_surface(height, width, seed)
    generator = torch.Generator().manual_seed(seed + 1)
    values = torch.rand(2, 3, height, width, generator=generator)
    deviation = torch.full((2, 1, height, width), 1.7)
    if per_pixel:
        deviation = 3 * torch.rand(2, 1, height, width, generator=generator)
        deviation[:, :, 0, 0] = 0
    edges = make_edges(make_guide(*surface), radius)
    fast = joint_bilateral(values, edges, radius, deviation if per_pixel else 1.7)
    torch.testing.assert_close(fast, slow_bilateral(values, surface, radius, deviation), rtol=1e-3, atol=1e-4)


def plane_edges(height: int, width: int, radius: int) -> Edges:
    return make_edges(plane_guide(height, width), radius)


def plane_guide(height: int, width: int) -> Guide:
    """A steep plane: 1/z falls linearly over the image."""
    disparity = torch.linspace(1, 0.1, height).view(1, 1, -1, 1) + torch.linspace(0, 0.5, width)
    normal = torch.tensor([0.0, 0.8, 0.6]).view(1, 3, 1, 1).expand(1, 3, height, width)
    return make_guide(normal, 1 / disparity, torch.ones(1, 1, height, width))


def test_a_plane_is_one_surface_however_steep() -> None:
    edges = plane_edges(20, 30, 15)
    assert len(edges.along_x) == len(edges.along_y) == 15
    for weights in (*edges.along_x, *edges.along_y):
        torch.testing.assert_close(weights, torch.ones_like(weights), atol=1e-3, rtol=0)


def test_nothing_comes_across_a_step_an_edge_or_from_the_sky() -> None:
    normal = torch.tensor([0.0, 0.0, 1.0]).view(1, 3, 1, 1).repeat(1, 1, 1, 8)
    depth, roughness = torch.full((1, 1, 1, 8), 5.0), torch.ones(1, 1, 1, 8)
    depth[..., 2:4] = 6.0
    normal[..., 4:6] = torch.tensor([1.0, 0.0, 0.0]).view(1, 3, 1, 1)
    depth[..., 4:6] = 5.0
    normal[..., 6:], depth[..., 6:] = 0.0, 0.0
    edges = make_edges(make_guide(normal, depth, roughness), 7)
    values = torch.zeros(1, 4, 1, 8)
    for surface in range(4):
        values[0, surface, 0, 2 * surface : 2 * surface + 2] = 1
    assert torch.equal(joint_bilateral(values, edges, 7, 5.0), values)


def test_a_constant_stays_constant_and_a_deviation_of_nothing_is_the_identity() -> None:
    edges = make_edges(make_guide(*random_surface(9, 9, 3)), 4)
    constant = torch.full((2, 1, 9, 9), 3.0)
    torch.testing.assert_close(joint_bilateral(constant, edges, 4, 2.0), constant)
    noise = torch.rand(2, 3, 9, 9)
    assert torch.equal(clean_up(noise, edges, torch.zeros(2, 1, 9, 9)), noise)


def test_the_clean_up_filter_is_nine_by_nine() -> None:
    impulse = torch.zeros(1, 1, 15, 15)
    impulse[0, 0, 7, 7] = 1
    spread = clean_up(impulse, plane_edges(15, 15, 15), torch.full((1, 1, 15, 15), 5.0)) > 0
    assert spread.nonzero()[:, 2:].amin(0).tolist() == [7 - CLEAN_UP_RADIUS] * 2
    assert spread.nonzero()[:, 2:].amax(0).tolist() == [7 + CLEAN_UP_RADIUS] * 2
    assert spread.sum() == 81


def test_each_pixel_has_its_own_deviation() -> None:
    edges = plane_edges(1, 40, 15)
    noise = torch.rand(1, 1, 1, 40)
    deviation = torch.where(torch.arange(40) < 20, 0.0, 4.0).view(1, 1, 1, 40)
    filtered = joint_bilateral(noise, edges, 15, deviation)
    assert torch.equal(filtered[..., :20], noise[..., :20])
    assert filtered[..., 20:].std() < 0.5 * noise[..., 20:].std()


@pytest.mark.parametrize("size", [(1, 1), (1, 5), (2, 3)])
def test_images_smaller_than_the_kernel(size: tuple[int, int]) -> None:
    edges = plane_edges(*size, 15)
    values = torch.rand(1, 2, *size)
    filtered = joint_bilateral(values, edges, 15, 1e6)
    torch.testing.assert_close(filtered, values.mean((2, 3), keepdim=True).expand_as(values), rtol=1e-3, atol=1e-3)
