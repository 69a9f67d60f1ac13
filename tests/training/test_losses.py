"""Eqs. 5 and 6 with numbers that can be checked by hand."""

import pytest
import torch
from torch import Tensor, nn

from nte.color import display
from nte.denoiser import Denoiser, Result
from nte.errors import NteError
from nte.frames.frame import Frame
from nte.motion.warp import warp
from nte.training.batch import Batch
from nte.training.losses import LossConfig, SequenceLoss, occlusion_loss
from nte.training.target import to_space

LINEAR = LossConfig(space="linear")


class Painter(nn.Module, Denoiser):
    """A stand-in for the network: its image is `color`, its mask the first component of `normal`."""

    needs = ("color", "normal")
    extras = ("disoccluded",)

    def step(self, frame: Frame, state: None, extras: tuple[str, ...] = ()) -> tuple[Result, None]:
        return Result(frame["color"], dict.fromkeys(extras, frame["normal"][:, :1])), None


def batch(images: list[float], references: list[float], masks: list[float] | None = None) -> Batch:
    """A frame per number: a constant image, a constant reference and a constant mask."""

    def constant(value: float) -> Tensor:
        return torch.full((1, 3, 2, 2), value)

    scalars = {"exposure": torch.ones(1), "depth_scale": torch.ones(1)}
    return [
        {"color": constant(i), "reference": constant(r), "albedo": constant(0.5), "normal": constant(m)} | scalars
        for i, r, m in zip(images, references, masks or [0.0] * len(images), strict=True)
    ]


def loss(config: LossConfig, frames: Batch, occlusion: float = 0.0, warmup: int = 0) -> tuple[float, dict[str, float]]:
    total, parts, _ = SequenceLoss(Painter(), config)(frames, occlusion, warmup)  # type: ignore[arg-type]
    return total.item(), {name: part.item() for name, part in parts.items()}


def test_spatial_and_temporal_loss_by_hand() -> None:
    # |I − R| = 1, 3, 1 and the changes of I − R are 4 and 2; the first frame has no temporal loss.
    total, parts = loss(LINEAR, batch([3, 4, 9], [2, 7, 10]))
    assert parts == pytest.approx({"spatial": 5 / 3, "temporal": 6 / 2})
    assert total == pytest.approx((5 + 6) / 3)


def test_one_frame_has_no_temporal_loss() -> None:
    assert loss(LINEAR, batch([3], [2])) == (1, {"spatial": 1})


def test_weights_scale_their_parts() -> None:
    config = LossConfig(space="linear", spatial=10.0, temporal=0.5, irradiance=2.0)
    total, parts = loss(config, batch([3, 4], [2, 7]))
    assert parts == pytest.approx({"spatial": 2, "temporal": 4, "irradiance": 2 / 0.5})
    assert total == pytest.approx((10 * 4 + 0.5 * 4 + 2 * 8) / 2)


def test_warm_up_frames_are_not_counted_but_are_the_past_of_the_first_that_is() -> None:
    total, parts = loss(LINEAR, batch([100, 4, 9], [2, 7, 10]), warmup=1)
    assert parts == pytest.approx({"spatial": 2, "temporal": (101 + 2) / 2})
    assert total == pytest.approx((3 + 1 + 101 + 2) / 2)


def test_masks_of_three_frames_weigh_the_occlusion_loss() -> None:
    # Σ w_k M_k with w = 1, 0.8, 0.6. An earlier mask that is missing is the frame's own, and frame 0 has none:
    # frame 0: 0; frame 1: 1·(1 + 0.8 + 0.6); frame 2: 0·1 + 1·0.8 + 0·0.6; frame 3: 0 + 0 + 0.6; frame 4: 0.
    frames = batch([1] * 5, [0] * 5, masks=[0, 1, 0, 0, 0])
    _, parts = loss(LINEAR, frames, occlusion=1.0)
    assert parts["occlusion"] == pytest.approx((2.4 + 0.8 + 0.6) / 5)
    # All hidden in every frame but the first: the full weight from frame 1 on.
    _, parts = loss(LINEAR, batch([1] * 4, [0] * 4, masks=[0, 1, 1, 1]), occlusion=1.0)
    assert parts["occlusion"] == pytest.approx(3 * 2.4 / 4)


def test_masks_of_warm_up_frames_are_remembered() -> None:
    frames = batch([1, 1, 1], [0, 0, 0], masks=[0, 1, 0])
    _, parts = loss(LINEAR, frames, occlusion=1.0, warmup=2)
    assert parts["occlusion"] == pytest.approx(0.8)


def test_the_phase_and_the_configuration_both_weigh_the_occlusion_loss() -> None:
    frames = batch([1], [0], masks=[1])
    for configured, phase in ((1.0, 0.5), (0.5, 1.0), (0.25, 2.0)):
        total, _ = loss(LossConfig(space="linear", occlusion=configured), frames, occlusion=phase)
        assert total == pytest.approx(1 + 0.5 * 2.4)
    assert "occlusion" not in loss(LINEAR, frames, occlusion=0.0)[1]


def test_the_occlusion_loss_grows_with_the_mask_unless_it_is_normalised() -> None:
    error = torch.ones(2, 3, 2, 4)
    error[..., 1:] = 3
    mask = torch.zeros(2, 1, 2, 4)
    assert occlusion_loss(error, mask, normalise=False) == 0
    assert occlusion_loss(error, mask, normalise=True) == 0
    mask[..., 0] = 2
    assert occlusion_loss(error, mask, normalise=False) == 2 * 1 / 4
    torch.testing.assert_close(occlusion_loss(error, mask, normalise=True), torch.tensor(1.0))
    mask[1] = 0  # a sequence without hidden pixels changes nothing
    torch.testing.assert_close(occlusion_loss(error, mask, normalise=True), torch.tensor(1.0))


def occlusion_gradient(hidden: Tensor) -> Tensor:
    """What each pixel of the image gets from a normalised loss, for a mask (N, H, W)."""
    image = torch.zeros(hidden.shape[0], 3, *hidden.shape[1:], requires_grad=True)
    occlusion_loss((image - 1).abs(), hidden[:, None].float(), normalise=True).backward()
    assert image.grad is not None
    return image.grad.abs()[:, 0]


def test_hidden_pixels_of_a_batch_get_the_same_gradient_however_many_their_neighbours_are() -> None:
    hidden = torch.zeros(2, 32, 40)
    hidden[0, 5, 7] = 1
    hidden[1, :30] = 1
    gradient = occlusion_gradient(hidden)
    torch.testing.assert_close(gradient[0, 5, 7], gradient[1, 3, 3])
    assert (gradient[hidden == 0] == 0).all()


def test_a_single_hidden_pixel_of_a_batch_gets_no_more_than_one_of_a_hundredth_of_the_pixels() -> None:
    single, hundredth, all_of_them = (torch.zeros(1, 40, 50) for _ in range(3))
    single[0, 1, 2] = 1
    hundredth[0, 0, :20] = 1
    all_of_them[:] = 1
    alone, some, each = (occlusion_gradient(hidden).max() for hidden in (single, hundredth, all_of_them))
    torch.testing.assert_close(alone, some)
    torch.testing.assert_close(alone, 100 * each)


@pytest.mark.parametrize("space", ["linear", "log", "display"])
@pytest.mark.parametrize("bad", [float("nan"), float("inf"), -20.0, -float("inf")])
def test_bad_pixels_of_the_reference_are_left_out(space: str, bad: float) -> None:
    # Slanted images, so that leaving a pixel out changes every mean; one component of one pixel of frame 1 is bad.
    frames = batch([3.0, 4.0, 9.0], [2.0, 7.0, 10.0], masks=[1, 1, 1])
    ramp = torch.arange(12.0).view(1, 3, 2, 2)
    for frame in frames:
        frame["reference"] = frame["reference"] + ramp
        frame["color"] = frame["color"].requires_grad_()
    frames[1]["reference"][0, 2, 0, 1] = bad
    config = LossConfig(space=space, irradiance=1.0, normalise_occlusion=True)
    total, parts, _ = SequenceLoss(Painter(), config)(frames, 1.0)  # type: ignore[arg-type]
    total.backward()
    gradient = frames[1]["color"].grad
    assert gradient is not None
    assert gradient.isfinite().all()
    assert (gradient[..., 0, 1] == 0).all()
    assert (gradient[..., 0, 0] != 0).all()

    def kept(values: Tensor, *bad_in: int) -> float:
        return float(values.flatten(2)[..., [0, 2, 3]].mean() if bad_in else values.mean())

    def shown(x: Tensor) -> Tensor:
        return to_space(x.detach(), torch.ones(1), space)

    errors = [shown(f["color"]) - shown(f["reference"]) for f in frames]
    assert parts["spatial"] == pytest.approx(
        (kept(errors[0].abs()) + kept(errors[1].abs(), 1) + kept(errors[2].abs())) / 3
    )
    changes = [(errors[1] - errors[0]).abs(), (errors[2] - errors[1]).abs()]
    assert parts["temporal"] == pytest.approx((kept(changes[0], 1) + kept(changes[1], 1)) / 2)
    assert parts["occlusion"] == pytest.approx(float(parts["spatial"]))


def test_a_reference_that_is_all_bad_costs_nothing() -> None:
    total, parts = loss(LossConfig(irradiance=1.0), batch([3.0, 4.0], [float("nan")] * 2, masks=[1, 1]), occlusion=1.0)
    assert total == 0
    assert set(parts.values()) == {0}


def test_spaces() -> None:
    radiance, exposure = torch.rand(2, 3, 4, 5) * 10, torch.tensor([0.5, 2.0])
    exposed = radiance * exposure.view(2, 1, 1, 1)
    torch.testing.assert_close(to_space(radiance, exposure, "linear"), exposed)
    torch.testing.assert_close(to_space(radiance, exposure, "log"), (1 + exposed).log())
    torch.testing.assert_close(to_space(radiance, exposure, "display"), display(radiance, exposure))
    brighter = to_space(radiance * 4, exposure / 4, "log")
    torch.testing.assert_close(brighter, to_space(radiance, exposure, "log"))


@pytest.mark.parametrize("space", ["linear", "log", "display"])
def test_a_perfect_image_costs_nothing_in_any_space(space: str) -> None:
    config = LossConfig(space=space, irradiance=1.0)
    total, _ = loss(config, batch([3, 5], [3, 5], masks=[1, 1]), occlusion=1.0)
    assert total == 0


def test_gradients_are_finite_in_every_space_even_in_the_dark() -> None:
    for space in ("linear", "log", "display"):
        image = torch.tensor([0.0, 1e-6, 1.0, 1e6]).view(1, 1, 2, 2).expand(1, 3, 2, 2).clone().requires_grad_()
        to_space(image, torch.ones(1), space).sum().backward()
        assert image.grad is not None
        assert image.grad.isfinite().all()


def test_a_configuration_that_makes_no_loss() -> None:
    with pytest.raises(NteError, match=r"loss.space is 'srgb'"):
        LossConfig(space="srgb").check()
    with pytest.raises(NteError, match=r"loss.mask_weights is empty"):
        LossConfig(mask_weights=[]).check()
    for weight in (float("nan"), -0.5, float("inf")):
        with pytest.raises(NteError, match=rf"loss.mask_weights is \[1.0, {weight}\], expected finite numbers of 0 or"):
            LossConfig(mask_weights=[1.0, weight]).check()
    LossConfig(mask_weights=[1.0, 0.0]).check()


class Mixer(nn.Module, Denoiser):
    """Two of its numbers mix the image with the warped one before and brighten it; its mask is given."""

    needs = ("color", "motion", "normal")
    extras = ("disoccluded",)

    def __init__(self, numbers: Tensor) -> None:
        super().__init__()
        self.numbers = numbers

    def step(self, frame: Frame, state: Tensor | None, extras: tuple[str, ...] = ()) -> tuple[Result, Tensor]:
        share, gain = self.numbers
        before = frame["color"] if state is None else warp(state, frame["motion"]).image
        image = gain * (share * frame["color"] + (1 - share) * before)
        return Result(image, dict.fromkeys(extras, frame["normal"][:, :1])), image


@pytest.mark.parametrize("space", ["linear", "log", "display"])
@pytest.mark.parametrize("distance", ["l1", "smape", "charbonnier"])
def test_gradients_of_a_whole_sequence_are_those_of_its_loss(space: str, distance: str) -> None:
    """Every part at once, through three frames of history: what differences of the loss itself say, in float64."""
    rng = torch.Generator().manual_seed(0)

    def positive(channels: int) -> Tensor:
        return 0.2 + torch.rand((1, channels, 12, 14), generator=rng, dtype=torch.float64)

    scalars = {name: torch.ones(1, dtype=torch.float64) for name in ("exposure", "depth_scale")}
    frames: Batch = [
        {
            "color": positive(3), "reference": positive(3), "albedo": positive(3), "motion": 2 * positive(2),
            "normal": (positive(3) > 0.7).double(),
        }
        | scalars
        for _ in range(4)
    ]  # fmt: skip
    parts = LossConfig(space=space, distance=distance, warped=0.7, irradiance=0.4, structure=0.3)

    def total(numbers: Tensor) -> Tensor:
        return SequenceLoss(Mixer(numbers), parts)(frames, 0.5).loss  # type: ignore[arg-type]

    numbers = torch.tensor([0.6, 1.1], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(total, (numbers,))
