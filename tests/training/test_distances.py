"""Distances by hand, the loss of structure by torchmetrics itself, and the temporal loss along the motion."""

import pytest
import torch
from torch import Tensor
from torchmetrics.functional.image import multiscale_structural_similarity_index_measure

from nte.errors import NteError
from nte.motion.warp import warp
from nte.training.distances import DISTANCES, masked_mean, structure_error, structure_scales
from nte.training.losses import LossConfig, SequenceLoss, occlusion_loss
from tests.training.test_losses import Painter, batch, loss


@pytest.mark.parametrize(
    ("distance", "expected"),
    [("l1", 2.0), ("charbonnier", (4 + 1e-6) ** 0.5 - 1e-3), ("smape", 2 / (3 + 5 + 0.01))],
)
def test_distances_by_hand(distance: str, expected: float) -> None:
    config = LossConfig(space="linear", distance=distance, irradiance=1.0)
    _, parts = loss(config, batch([3.0], [5.0], masks=[1]), occlusion=1.0)
    assert parts["spatial"] == pytest.approx(expected)
    assert parts["occlusion"] == pytest.approx(2.4 * expected)
    # Divided by the texture of 0.5, image and reference are twice as bright.
    assert parts["irradiance"] == pytest.approx({"smape": 4 / 16.01}.get(distance, 2 * expected), rel=1e-3)


def test_a_change_counts_relative_to_the_light_that_changes() -> None:
    # The change of I − R is 4, between 9 + 10 of exposed light.
    _, parts = loss(LossConfig(space="linear", distance="smape"), batch([4, 9], [9, 10]))
    assert parts["temporal"] == pytest.approx(4 / 19.01)


@pytest.mark.parametrize("name", DISTANCES)
def test_gradients_of_distances_are_those_of_finite_differences(name: str) -> None:
    difference = torch.rand(2, 3, 4, 5, dtype=torch.float64) + 0.1
    difference[0] *= -1  # on either side of the kink at 0
    magnitude = torch.rand(2, 3, 4, 5, dtype=torch.float64) + 0.1
    usable = torch.rand(2, 1, 4, 5) < 0.7
    given = difference.requires_grad_(), magnitude.requires_grad_(name == "smape")
    assert torch.autograd.gradcheck(lambda *x: masked_mean(DISTANCES[name](*x), usable), given)


@pytest.mark.parametrize("normalise", [False, True])
def test_gradients_of_the_occlusion_loss_are_those_of_finite_differences(normalise: bool) -> None:
    error = torch.rand(2, 3, 4, 5, dtype=torch.float64, requires_grad=True)
    weights = torch.rand(2, 1, 4, 5, dtype=torch.float64)
    assert torch.autograd.gradcheck(lambda e: occlusion_loss(e, weights, normalise), (error,))


def test_the_gradient_of_structure_is_that_of_finite_differences() -> None:
    image, reference = torch.rand(2, 1, 3, 12, 13, dtype=torch.float64)
    usable = torch.ones(1, 1, 12, 13, dtype=torch.bool)
    usable[..., 3:5, 4:8] = False
    given = image.requires_grad_(), reference
    assert torch.autograd.gradcheck(lambda *x: structure_error(*x, usable), given, fast_mode=True)


@pytest.mark.parametrize("name", DISTANCES)
def test_distances_are_symmetric_and_have_finite_gradients_at_zero(name: str) -> None:
    difference = torch.tensor([-1.5, 0.0, 1.5, 1e6], requires_grad=True)
    values = DISTANCES[name](difference, torch.tensor([3.0, 0.0, 3.0, 1e6]))
    values.sum().backward()
    assert values[0] == values[2] > values[1] == 0
    assert difference.grad is not None
    assert difference.grad.isfinite().all()


def pair(side: int, noise: float) -> tuple[Tensor, Tensor]:
    """A slanted coloured ramp, and the same with noise; (2, 3, side, side + 9)."""
    y, x = torch.meshgrid(torch.arange(float(side)), torch.arange(side + 9.0), indexing="ij")
    ramp = ((x + 0.4 * y) / (2 * side + 9) * torch.tensor([0.9, 0.6, 0.3]).view(1, 3, 1, 1)).expand(2, -1, -1, -1)
    return (ramp + noise * torch.rand_like(ramp)).clamp(0, 1), ramp


@pytest.mark.parametrize(("side", "scales"), [(10, 0), (11, 1), (22, 2), (44, 3), (96, 3), (99, 4), (176, 5)])
def test_an_image_has_as_many_scales_as_fit(side: int, scales: int) -> None:
    assert structure_scales(side) == scales
    image, reference = pair(side, 0.2)
    error = structure_error(image.requires_grad_(), reference, torch.ones(2, 1, 1, 1, dtype=torch.bool))
    assert (error > 0) == (scales > 0)


def test_structure_is_torchmetrics_and_bad_pixels_do_not_count() -> None:
    image, reference = pair(176, 0.3)
    usable = torch.ones(2, 1, 176, 185, dtype=torch.bool)
    expected = 1 - multiscale_structural_similarity_index_measure(image, reference, data_range=1.0, normalize="simple")
    # The published weights of the scales sum to 1.0001, ours to 1.
    torch.testing.assert_close(structure_error(image, reference, usable), expected, rtol=1e-3, atol=0)
    usable[:, :, 20:40, 30:60] = False
    spoilt = torch.where(usable, reference, 0.9).requires_grad_()
    error = structure_error(spoilt, reference, usable)
    assert error.item() == pytest.approx(0, abs=1e-6)
    error.backward()
    assert spoilt.grad is not None
    assert (spoilt.grad[~usable.expand_as(spoilt)] == 0).all()
    assert spoilt.grad.isfinite().all()


def test_flat_and_black_images_have_finite_gradients_of_structure() -> None:
    image = torch.zeros(1, 3, 44, 44, requires_grad=True)
    structure_error(image, pair(44, 0.0)[1][:1, ..., :44], torch.ones(1, 1, 1, 1, dtype=torch.bool)).backward()
    assert image.grad is not None
    assert image.grad.isfinite().all()
    assert image.grad.abs().max() > 0


def moving(count: int, bad: int | None = None) -> list[dict[str, Tensor]]:
    """Frames of a texture that moves by (2, −1) px a frame; the image's error moves with it, and a pixel may be bad."""
    generator = torch.Generator().manual_seed(3)
    texture, error = (torch.rand(1, 3, 40, 44, generator=generator) for _ in range(2))
    motion = torch.tensor([-2.0, 1.0]).view(1, 2, 1, 1).expand(1, 2, 12, 16)
    frames = []
    for i in range(count):
        rows, columns = slice(10 + i, 22 + i), slice(14 - 2 * i, 30 - 2 * i)
        clean = texture[..., rows, columns].clone()
        image = clean + error[..., rows, columns]
        if i == bad:
            clean[..., 5, 7] = float("nan")
        one = {"color": image, "reference": clean, "motion": motion, "normal": torch.zeros_like(clean)}
        frames.append(one | {"exposure": torch.ones(1)})
    return frames


@pytest.mark.parametrize("bad", [None, 0, 1])
def test_an_error_that_moves_with_its_surface_costs_nothing_along_the_motion(bad: int | None) -> None:
    # Half of an error is no multiple of a rounding; at the border nothing is known of the previous frame.
    config = LossConfig(space="linear", warped=1.0)
    frames = moving(2, bad)
    _, parts, _ = SequenceLoss(Painter(), config)(frames, 0.0)  # type: ignore[arg-type]
    assert parts["warped"] == pytest.approx(0, abs=1e-5)
    assert parts["temporal"] > 0.1


def test_the_loss_along_the_motion_by_hand() -> None:
    config, frames = LossConfig(space="log", warped=0.5, spatial=0.0, temporal=0.0), moving(3)
    frames[1]["color"] = frames[1]["color"].flip(-1)
    total, parts, _ = SequenceLoss(Painter(), config)(frames, 0.0)  # type: ignore[arg-type]
    logs = [(f["color"] + 1).log() - (f["reference"] + 1).log() for f in frames]
    expected = 0.0
    for now, before, frame in zip(logs[1:], logs, frames[1:], strict=False):
        fetched = warp(before, frame["motion"])
        change = (now - fetched.image).abs()[fetched.valid.expand_as(now)].mean()
        expected += 0.5 * float(change)
    assert parts["warped"] == pytest.approx(expected)  # half of it, in each of two frames
    assert total.item() == pytest.approx(expected / 3)


def test_losses_that_are_none_and_channels_that_they_need() -> None:
    with pytest.raises(NteError, match=r"loss.distance is 'l2', expected l1, smape or charbonnier"):
        LossConfig(distance="l2").check()
    assert "motion" in LossConfig(warped=1.0).channels(SequenceLoss(Painter(), LossConfig()).target)  # type: ignore[arg-type]
