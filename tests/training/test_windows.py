"""Gradients through windows of a sequence, warm-up without them, and steps over several batches."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from lightning_fabric import Fabric
from torch import Tensor, nn

from nte.denoiser import Denoiser, Result
from nte.frames.frame import Frame
from nte.training.batch import Batch
from nte.training.config import TrainConfig
from nte.training.losses import LossConfig, SequenceLoss, windows
from nte.training.meter import STAGES, Meter
from nte.training.schedule import Settings
from nte.training.step import Stepper
from tests.networks import small_network
from tests.synthetic import random_channels
from tests.training.runs import tiny_config


class Leaky(nn.Module, Denoiser):
    """A recurrence that can be differentiated by hand: y = a·y₋₁ + x, and its mask is `normal`."""

    needs = ("color", "normal")
    extras = ("disoccluded",)

    def __init__(self) -> None:
        super().__init__()
        self.a = nn.Parameter(torch.tensor(0.5))
        self.seen: list[tuple[int, bool]] = []

    def step(self, frame: Frame, state: Any, extras: tuple[str, ...] = ()) -> tuple[Result, Any]:
        before = torch.zeros_like(frame["color"]) if state is None else state["y"]
        image = self.a * before + frame["color"]
        self.seen.append((frame.index, image.requires_grad))
        return Result(image, dict.fromkeys(extras, frame["normal"][:, :1])), {"y": image}


def batch(images: list[float], masks: list[float] | None = None) -> Batch:
    """A frame per number, before a black reference."""
    masks = masks or [0.0] * len(images)
    return [
        {
            "color": torch.full((1, 3, 2, 2), image), "reference": torch.zeros(1, 3, 2, 2),
            "normal": torch.full((1, 3, 2, 2), mask), "exposure": torch.ones(1),
        }
        for image, mask in zip(images, masks, strict=True)
    ]  # fmt: skip


def gradients(images: list[float], length: int, warmup: int = 0, **losses: float) -> tuple[Leaky, float, Tensor]:
    """The network, the loss and its gradient, window by window."""
    network = Leaky()
    config = LossConfig(space="linear", **({"temporal": 0.0} | losses))  # type: ignore[arg-type]
    loss, past, total = SequenceLoss(network, config), None, 0.0  # type: ignore[arg-type]
    for window in windows(len(images), warmup, length):
        unrolled = loss(batch(images), 0.0, warmup, window, past)
        unrolled.loss.backward()
        past, total = unrolled.past, total + unrolled.loss.item()
    assert network.a.grad is not None
    return network, total, network.a.grad


def test_windows_cover_a_sequence_once_and_warm_up_belongs_to_the_first() -> None:
    assert windows(5, 0, 0) == [slice(0, 5)]
    assert windows(5, 2, 0) == [slice(0, 5)]
    assert windows(7, 0, 3) == [slice(0, 3), slice(3, 6), slice(6, 7)]
    assert windows(7, 2, 2) == [slice(0, 4), slice(4, 6), slice(6, 7)]
    assert windows(3, 0, 9) == [slice(0, 3)]


def test_gradients_end_at_a_window_and_values_do_not() -> None:
    # y = 1, 1.5, 1.75, 1.875 for a = 0.5. dy/da = 0, 1, 2, 2.75; within windows of two frames 0, 1 and 1.5, 2.5.
    ones = [1.0] * 4
    for length, slopes in ((0, [0, 1, 2, 2.75]), (2, [0, 1, 1.5, 1.75 + 0.5 * 1.5]), (1, [0, 1, 1.5, 1.75])):
        network, loss, slope = gradients(ones, length)
        assert loss == pytest.approx((1 + 1.5 + 1.75 + 1.875) / 4)
        assert slope.item() == pytest.approx(sum(slopes) / 4)
        assert [index for index, _ in network.seen] == [0, 1, 2, 3]


def test_the_losses_of_windows_sum_to_that_of_the_sequence_with_its_changes_and_masks() -> None:
    images, masks = [1.0, 3.0, 2.0, 7.0, 4.0], [1.0, 0.0, 0.0, 1.0, 0.0]
    whole = LossConfig(space="linear", temporal=0.5, occlusion=2.0)
    totals = []
    for length in (0, 1, 2, 3):
        loss, past, total = SequenceLoss(Leaky(), whole), None, 0.0  # type: ignore[arg-type]
        for window in windows(5, 1, length):
            unrolled = loss(batch(images, masks), 1.0, 1, window, past)
            past, total = unrolled.past, total + unrolled.loss.item()
        totals.append(total)
    assert totals[1:] == pytest.approx(totals[:1] * 3)


def test_warm_up_frames_have_no_gradients_and_no_losses() -> None:
    network, loss, slope = gradients([1.0] * 4, 0, warmup=2)
    assert network.seen == [(0, False), (1, False), (2, True), (3, True)]
    assert loss == pytest.approx((1.75 + 1.875) / 2)
    assert slope.item() == pytest.approx((1.5 + 1.75 + 0.5 * 1.5) / 2)  # those of windows that begin with frame 2


def stepped(config: TrainConfig, batches: list[Batch]) -> tuple[float, dict[str, Tensor], Tensor, Meter]:
    """Loss, parts, weights and meter after one step of plain gradient descent."""
    fabric = Fabric(accelerator="cpu", devices=1)
    network = Leaky()
    optimiser = torch.optim.SGD(network.parameters(), lr=1.0)
    model, optimiser = fabric.setup(SequenceLoss(network, LossConfig(space="linear")), optimiser)  # type: ignore[arg-type]
    meter = Meter(1)
    loss, parts = Stepper(fabric, model, optimiser, config, meter).step(iter(batches), Settings(0.25, 0.0))
    return loss.item(), parts, network.a.detach(), meter


def test_a_step_over_two_batches_is_one_over_both(tmp_path: Path, noisy_disc: Path) -> None:
    choices = "optimiser.clip_norm=0", "data.frames=3"
    one, other = batch([1.0, 2.0, 5.0]), batch([4.0, 1.0, 2.0])
    both = [{name: torch.cat([a[name], b[name]]) for name in a} for a, b in zip(one, other, strict=True)]
    loss, parts, weight, _ = stepped(tiny_config(tmp_path, noisy_disc, *choices), [both])
    for more in ((), ("data.window=1",), ("data.window=2",)):
        config = tiny_config(tmp_path, noisy_disc, *choices, "optimiser.accumulate=2", *more)
        found = stepped(config, [one, other])
        assert found[0] == pytest.approx(loss, rel=1e-5)
        assert found[1]["spatial"].item() == pytest.approx(parts["spatial"].item(), rel=1e-5)
        if not more:
            assert found[2].item() == pytest.approx(weight.item(), abs=1e-5)
            assert weight.item() != 0.5


def test_the_meter_knows_every_stage_of_a_step(tmp_path: Path, noisy_disc: Path) -> None:
    config = tiny_config(tmp_path, noisy_disc, "data.frames=3", "data.window=1")
    meter = stepped(config, [batch([1.0, 2.0, 5.0])])[-1]
    assert set(meter.seconds) == set(STAGES)
    assert all(seconds > 0 for seconds in meter.seconds.values())
    assert sum(meter.seconds.values()) <= meter.total


def test_warm_up_in_bfloat16_leaves_gradients_to_the_frames_after_it() -> None:
    """Autocast keeps what it has cast, and what it cast without gradients must not serve a frame that needs them."""
    gradients = []
    for mixed in (False, True):
        network = small_network().requires_grad_(True)
        rng = np.random.default_rng(3)
        batch = [{name: torch.from_numpy(v) for name, v in random_channels(rng, (16, 16)).items()} for _ in range(3)]
        scalars = {"exposure": torch.ones(1), "depth_scale": torch.ones(1)}
        frames = [frame | scalars | {"reference": torch.ones(1, 3, 16, 16)} for frame in batch]
        SequenceLoss(network, LossConfig(), mixed)(frames, 0.0, 2).loss.backward()
        gradients.append([parameter.grad for parameter in network.parameters()])
    for exact, rounded in zip(*gradients, strict=True):
        assert exact is not None
        assert rounded is not None
        assert (rounded - exact).norm() < 0.2 * exact.norm() + 1e-6
