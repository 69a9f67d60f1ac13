"""Six cones of incident radiance: their geometry, their overlap, and the light they give back."""

import functools
import math

import numpy as np
import pytest
import torch
from torch import Tensor

from nte.filters.trmv import cones
from nte.filters.trmv.cones import CONES, EQ_11, HALF_ANGLE, WEIGHTS
from tests.filters.trmv_frames import directions


def random_normals(count: int, seed: int = 0) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.nn.functional.normalize(torch.randn(count, 3, generator=generator), dim=1)


@functools.cache
def uniform_sphere(count: int) -> Tensor:
    generator = torch.Generator().manual_seed(1)
    return torch.nn.functional.normalize(torch.randn(count, 3, generator=generator, dtype=torch.float64), dim=1)


@pytest.mark.parametrize("half_angle", [HALF_ANGLE, math.pi / 6])
@pytest.mark.parametrize("apart", [0.0, 5.0, 20.0, 45.0, 60.0, 63.0, 80.0, 180.0])
def test_the_overlap_is_what_monte_carlo_counts(apart: float, half_angle: float) -> None:
    sphere = uniform_sphere(300_000)
    axis = torch.tensor([math.sin(math.radians(apart)), 0.0, math.cos(math.radians(apart))], dtype=torch.float64)
    inside = (sphere[:, 2] > math.cos(half_angle)) & (sphere @ axis > math.cos(half_angle))
    share = inside.double().mean()
    error = 4 * math.pi * math.sqrt(max(float(share), 1e-6) / 300_000)
    found = cones.overlap(torch.tensor(math.cos(math.radians(apart)), dtype=torch.float64), half_angle)
    assert float(found) == pytest.approx(4 * math.pi * float(share), abs=4 * error)


def test_a_cone_overlaps_itself_wholly_and_a_distant_one_not_at_all() -> None:
    one = torch.tensor(1.0)
    assert float(cones.overlap(one, HALF_ANGLE)) == pytest.approx(math.pi / 3, rel=1e-5)
    assert float(cones.overlap(torch.tensor(math.cos(2 * HALF_ANGLE + 0.01)), HALF_ANGLE)) == 0
    assert float(cones.overlap(-one, HALF_ANGLE)) == 0


def test_weights_sum_to_pi_and_the_papers_to_twice_that() -> None:
    assert math.fsum(WEIGHTS) == pytest.approx(math.pi, abs=1e-12)
    assert math.fsum(EQ_11) == pytest.approx(2 * math.pi, abs=1e-12)


def test_one_axis_along_the_normal_and_five_around_it() -> None:
    normals = random_normals(200)
    axes = cones.cone_axes(normals)
    torch.testing.assert_close(axes.norm(dim=2), torch.ones(200, CONES), atol=1e-3, rtol=0)
    torch.testing.assert_close(axes[:, 0], normals, atol=1e-5, rtol=0)
    torch.testing.assert_close(axes[:, 1:] @ normals[..., None], torch.full((200, 5, 1), 0.5), atol=1e-3, rtol=0)
    neighbours = (axes[:, 1:] * axes[:, 1:].roll(1, 1)).sum(2)
    expected = 0.25 + 0.75 * math.cos(2 * math.pi / 5)
    torch.testing.assert_close(neighbours, torch.full((200, 5), expected), atol=1e-3, rtol=0)


def test_frames_turn_as_little_as_normals_do_on_walls_and_floors() -> None:
    straight = torch.cat([torch.eye(3), -torch.eye(3)]).repeat_interleave(20, 0)
    near = torch.nn.functional.normalize(straight + 1e-3 * random_normals(120), dim=1)
    assert (cones.cone_axes(straight) - cones.cone_axes(near)).abs().max() < 5e-3


def test_a_sample_goes_to_the_cone_with_the_nearest_axis() -> None:
    normals = random_normals(60).T.reshape(1, 3, 6, 10)
    light, direction = torch.rand(1, 3, 6, 10), random_normals(60, seed=5).T.reshape(1, 3, 6, 10).clone()
    direction[0, :, 0, 0] = 0
    found = cones.by_cone(cones.sample_to_cones(light, direction, normals), 4)
    for y in range(6):
        for x in range(10):
            axes = cones.cone_axes(normals[:, :, y, x])[0]
            expected = torch.zeros(CONES, 4)
            if direction[0, :, y, x].any():
                expected[int((axes @ direction[0, :, y, x]).argmax())] = torch.cat([light[0, :, y, x], torch.ones(1)])
            torch.testing.assert_close(found[0, :, :, y, x], expected)


def slow_transfer(history: Tensor, normal: Tensor, to: Tensor) -> tuple[Tensor, Tensor]:
    """Of one pixel: history (6, 4), normals (3,)."""
    own, other = cones.cone_axes(to[None])[0], cones.cone_axes(normal[None])[0]
    moved, covered = torch.zeros(CONES, 4), torch.zeros(CONES)
    for k in range(CONES):
        total = 0.0
        for j in range(CONES):
            share = float(cones.overlap(own[k] @ other[j], HALF_ANGLE)) / (math.pi / 3)
            moved[k] += share * history[j]
            total += share
        if total > 0:
            moved[k] /= total
        covered[k] = min(1, total)
    return moved, covered


def test_history_at_another_normal_is_the_mean_by_overlap() -> None:
    history, normal = torch.rand(1, 24, 3, 8), random_normals(24).T.reshape(1, 3, 3, 8)
    to = torch.nn.functional.normalize(normal + 0.7 * random_normals(24, 7).T.reshape(1, 3, 3, 8), dim=1)
    to[..., :2] = normal[..., :2]  # equal normals take the short way
    moved, covered = cones.transfer(history, normal, to, HALF_ANGLE)
    for y in range(3):
        for x in range(8):
            expected, share = slow_transfer(
                cones.by_cone(history, 4)[0, :, :, y, x], normal[0, :, y, x], to[0, :, y, x]
            )
            torch.testing.assert_close(cones.by_cone(moved, 4)[0, :, :, y, x], expected, atol=2e-3, rtol=2e-3)
            torch.testing.assert_close(covered[0, :, y, x], share, atol=2e-3, rtol=0)


def test_nothing_is_carried_to_the_other_side() -> None:
    up = torch.tensor([0.0, 1.0, 0.0]).view(1, 3, 1, 1)
    moved, covered = cones.transfer(torch.ones(1, 24, 1, 1), up, -up, HALF_ANGLE)
    # The rings of both hemispheres are 60° apart at least: what little they share is all there is.
    assert covered.max() < 0.2
    assert (covered[0, 0] == 0).all()
    assert cones.split(moved)[1][0, 0] == 0


def test_an_empty_cone_is_unknown_and_not_black() -> None:
    known = torch.zeros(1, CONES, 4, 1, 1)
    known[0, 2] = torch.tensor([0.2, 0.4, 0.6, 0.1]).view(4, 1, 1)
    known[0, 4] = torch.tensor([1.2, 0.4, 0.6, 0.3]).view(4, 1, 1)
    radiance = cones.by_cone(cones.radiance_of(known.flatten(1, 2)), 3)[0, :, :, 0, 0]
    torch.testing.assert_close(radiance[2], torch.tensor([2.0, 4.0, 6.0]))
    torch.testing.assert_close(radiance[0], torch.tensor([1.4, 0.8, 1.2]) / 0.4)
    assert (cones.radiance_of(torch.zeros(1, 24, 1, 1)) == 0).all()


def test_an_empty_cone_takes_from_those_it_overlaps_of_its_own_pixel() -> None:
    sample = cones.sample_to_cones(torch.ones(1, 3, 1, 1), *(2 * [torch.tensor([0, 0, 1.0]).view(1, 3, 1, 1)]))
    weight = cones.split(cones.mix_parallel(sample, HALF_ANGLE))[1].flatten()
    torch.testing.assert_close(weight, torch.tensor([1.0, *(5 * [0.04395])]), atol=1e-4, rtol=0)
    assert torch.equal(cones.split(cones.mix_parallel(sample, math.pi / 6))[1].flatten()[1:] > 1e-6, torch.zeros(5) > 0)


@pytest.mark.parametrize(("slope", "tolerance"), [(0.0, 1e-5), (1.0, 0.03)])
def test_cosine_weighted_samples_give_the_irradiance_back(slope: float, tolerance: float) -> None:
    # L = 1 + slope · cos θ about any normal: irradiance / π = 1 + slope · 2/3. Cells around the axes are not quite
    # what their weights say: the one at the normal holds 27.6 % of the cosine, not 25 %.
    normal = torch.tensor([0.6, 0.0, 0.8]).view(1, 3, 1, 1).expand(1, 3, 100, 100)
    direction = torch.as_tensor(directions(np.random.default_rng(0), normal.numpy()))
    light = (1 + slope * (normal * direction).sum(1, keepdim=True)).expand(-1, 3, -1, -1)
    total = cones.sample_to_cones(light, direction, normal).mean((2, 3), keepdim=True)
    found = cones.irradiance(cones.radiance_of(total))
    torch.testing.assert_close(found.flatten(), torch.full((3,), 1 + slope * 2 / 3), rtol=tolerance, atol=0)
