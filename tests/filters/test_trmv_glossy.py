"""Stochastic reflection vectors, the noise that draws them, and a filter as wide as the lobe."""

import numpy as np
import pytest
import torch

from nte.filters.noise import gaussian_noise
from nte.filters.trmv import Trmv
from nte.filters.trmv.glossy import (
    SCALE,
    WIDEST_DRAW,
    Lobes,
    draw,
    filter_glossy,
    gather_lobes,
    glossy_reprojection,
    limit_spread,
    spread_of,
)
from nte.filters.trmv.inputs import FrameInputs, prepare
from nte.filters.trmv.options import TrmvOptions
from nte.session import Session
from tests.filters.trmv_frames import plane

CPU = torch.device("cpu")


def ready_inputs(size: tuple[int, int], **given: object) -> FrameInputs:
    return prepare(plane(size=size, **given).torch(), None)  # type: ignore[arg-type]


def test_noise_is_normal_and_independent_of_pixel_frame_and_dimension() -> None:
    frames = torch.cat([gaussian_noise(128, 128, frame, CPU) for frame in (0, 1, 2)]).flatten(1)
    values = torch.cat([frames, frames.roll(1, 1), frames.view(3, 2, -1)[:, 0:1].roll(128, 2).flatten(1)], 1)
    assert values.mean().abs() < 0.01
    assert float(values.square().mean()) == pytest.approx(1, abs=0.02)
    assert float(values.pow(4).mean()) == pytest.approx(3, abs=0.15)
    first, second = frames.view(3, 2, -1).unbind(1)
    for a, b in ((first, second), (first[0], first[1]), (first, first.roll(1, 1)), (first, first.roll(128, 1))):
        assert (a * b).mean().abs() < 0.02


def test_noise_is_a_function_of_pixel_and_frame() -> None:
    assert torch.equal(gaussian_noise(5, 7, 3, CPU), gaussian_noise(5, 7, 3, CPU))
    assert not torch.equal(gaussian_noise(5, 7, 3, CPU), gaussian_noise(5, 7, 4, CPU))
    assert gaussian_noise(5, 7, 3, CPU).isfinite().all()


@pytest.mark.parametrize(
    "covariance", [(4.0, 0.0, 1.0), (9.0, 4.0, 2.0), (1.0, -1.0, 1.0), (0.0, 0.0, 4.0), (0.0, 0.0, 0.0)]
)
def test_vectors_are_drawn_with_their_mean_and_covariance(covariance: tuple[float, float, float]) -> None:
    shape = (1, 1, 160, 160)
    mean = torch.tensor([3.0, -2.0]).view(1, 2, 1, 1).expand(1, 2, 160, 160)
    spread = torch.tensor(covariance).view(1, 3, 1, 1).expand(1, 3, 160, 160)
    drawn = draw(Lobes(mean, mean, spread, torch.ones(shape) > 0), 5, torch.rand(shape)).flatten(2)[0]
    torch.testing.assert_close(drawn.mean(1), torch.tensor([3.0, -2.0]), atol=0.05, rtol=0)
    xx, xy, yy = covariance
    torch.testing.assert_close(torch.cov(drawn), torch.tensor([[xx, xy], [xy, yy]]), atol=0.02, rtol=0.03)


def test_what_another_pixel_shows_does_not_change_a_draw() -> None:
    shape = (1, 1, 6, 8)
    mean, light = torch.zeros(1, 2, 6, 8), torch.rand(1, 3, 6, 8, generator=torch.Generator().manual_seed(0))
    lobes = Lobes(mean, mean, torch.tensor([1.0, 0, 1]).view(1, 3, 1, 1), torch.ones(shape) > 0)
    other = light.clone()
    other[..., 2, 5] += 1
    changed = (draw(lobes, 3, light) != draw(lobes, 3, other)).any(1)[0]
    assert changed.nonzero().tolist() == [[2, 5]]


def test_pixels_whose_path_went_elsewhere_take_the_lobe_of_those_around_them() -> None:
    mean, covariance = torch.full((1, 2, 1, 20), float("nan")), torch.full((1, 3, 1, 20), float("nan"))
    mean[..., 2], covariance[..., 2] = 4.0, 1.0
    mean[..., 4], covariance[..., 4] = 8.0, 3.0
    found = gather_lobes(mean, covariance, ready_inputs((1, 20)).edges)
    assert found.glossy.flatten().tolist() == [True] * 12 + [False] * 8  # seven pixels around
    assert found.mean[0, 0, 0, 2] == 4
    assert found.mean[0, 0, 0, 4] == 8
    torch.testing.assert_close(found.mean[0, 0, 0, 3], torch.tensor(6.0))
    assert 4 < found.specular[0, 0, 0, 2] < found.specular[0, 0, 0, 4] < 8  # one vector for the lobe, not the sample's
    assert (found.mean[..., 12:] == 0).all()
    spread = spread_of(covariance, ready_inputs((1, 20)).edges)
    assert (spread[..., 12:] == 0).all()
    assert (spread[..., :12] > 0).all()


def test_the_filter_is_as_wide_as_the_lobe_and_leaves_a_mirror_alone() -> None:
    edges = ready_inputs((32, 32)).edges
    noise = torch.rand(1, 3, 32, 32)
    assert torch.equal(filter_glossy(noise, torch.zeros(1, 1, 32, 32), edges), noise)
    deviations = [float(filter_glossy(noise, torch.full((1, 1, 32, 32), s), edges).std()) for s in (0.0, 1.0, 3.0, 9.0)]
    assert deviations == sorted(deviations, reverse=True)
    assert deviations[3] < 0.2 * deviations[0]


def test_what_reflects_nothing_uses_the_traditional_vector() -> None:
    ready = ready_inputs((4, 6), motion=-torch.ones(1, 2, 4, 6).numpy())
    glossy = torch.zeros(1, 1, 4, 6, dtype=torch.bool)
    glossy[..., 3] = True
    found = glossy_reprojection(torch.full((1, 2, 4, 6), 2.0), glossy, ready)
    assert (found.motion[..., 3] == 2).all()
    assert (found.motion[..., :3] == -1).all()


def test_so_does_a_reflection_that_was_not_on_its_reflector() -> None:
    ready = ready_inputs((1, 10))
    roughness = ready.gbuffer.roughness.clone()
    roughness[..., 6:8] = 1.0  # a diffuse thing before the floor
    depth = ready.gbuffer.depth.clone()
    depth[..., 8:] = 0.0  # the sky
    ready = ready._replace(before=ready.gbuffer._replace(roughness=roughness, depth=depth))
    motion = torch.tensor([3.0, 0.0]).view(1, 2, 1, 1).expand(1, 2, 1, 10)
    found = glossy_reprojection(motion, torch.ones(1, 1, 1, 10, dtype=torch.bool), ready)
    assert found.motion[0, 0, 0].tolist() == [3, 3, 3, 0, 0, 0, 0, 3, 3, 3]
    assert found.valid[0, 0, 0].tolist() == [True] * 7 + [False] * 3  # out of the image there is no history


def test_near_a_focus_lobes_keep_their_shape_and_a_bound() -> None:
    covariance = torch.tensor([[1e6, 5e5, 1e6], [4.0, 1.0, 2.0], [0.0, 0.0, 0.0], [1e12, 0.0, 1.0]]).T.view(1, 3, 1, 4)
    found = limit_spread(covariance)
    matrices = found[0, [0, 1, 1, 2], 0].T.view(4, 2, 2).double()
    assert torch.linalg.eigvalsh(matrices).max() <= WIDEST_DRAW**2 * (1 + 1e-5)
    torch.testing.assert_close(found[0, 1, 0, 0] / found[0, 0, 0, 0], torch.tensor(0.5))
    assert torch.equal(found[..., 1:3], covariance[..., 1:3])


def test_one_reflection_near_a_focus_moves_nobody_elses() -> None:
    edges = ready_inputs((40, 60)).edges
    mean, covariance = torch.full((1, 2, 40, 60), 1.0), torch.full((1, 3, 40, 60), 0.5)
    mean[..., ::2], covariance[..., ::2] = float("nan"), float("nan")
    clean, width = gather_lobes(mean, covariance, edges), spread_of(covariance, edges)
    mean[..., 20, 31], covariance[..., 20, 31] = 1e6, 1e30
    spoilt = gather_lobes(mean, limit_spread(covariance), edges)
    torch.testing.assert_close(spoilt.mean, clean.mean)
    torch.testing.assert_close(spoilt.specular, clean.specular)
    assert spread_of(limit_spread(covariance), edges).max() < 15
    assert width.max() < 1


@pytest.mark.parametrize("alpha", [0.1, 0.3])
def test_redrawn_vectors_blur_what_rests_as_often_as_history_is_fetched(alpha: float) -> None:
    """Of a sine of frequency k, a Gaussian of variance σ² leaves g = e^−k²σ²/2: h = α s + (1 − α) g h at rest."""
    size, length, deviation = (32, 72), 24, 1.0
    x = np.arange(size[1]) + 0.5
    sine = np.broadcast_to(np.sin(2 * np.pi / length * x), size)
    lobe = np.broadcast_to(np.reshape([deviation**2, 0, deviation**2], (1, 3, 1, 1)), (1, 3, *size))
    light = np.broadcast_to(1 + 0.5 * sine, (1, 3, *size))
    session = Session(Trmv(TrmvOptions("glossy", alpha=alpha, clamp=float("inf"), cleanup=False)))
    images = [
        session.denoise(plane(index, size, glossy=light, reflection_covariance=lobe.astype(np.float32)))
        for index in range(48)
    ]
    inner = slice(length // 2, -length // 2)
    left = 4 * (np.mean(images[24:], (0, 1, 2)) * sine)[:, inner].mean()
    per_draw, of_filter = (np.exp(-0.5 * (2 * np.pi / length * d) ** 2) for d in (deviation, SCALE * deviation))
    assert left == pytest.approx(of_filter * alpha / (1 - (1 - alpha) * per_draw), abs=0.025)
