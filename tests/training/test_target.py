"""What a network approximates decides how its images are compared: light has an exposure, a share has none."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from nte.denoiser import Denoiser, Result
from nte.errors import NteError
from nte.frames.channels import CHANNELS, TARGETS
from nte.frames.clip import Clip
from nte.frames.frame import Frame
from nte.models.trainable import NetworkConfig, TrainableDenoiser
from nte.training.losses import LossConfig, SequenceLoss
from nte.training.target import Target
from nte.training.validation import ValidationSet, validate
from tests.synthetic import disc_frame, write_clip


@dataclass
class ShadowConfig(NetworkConfig):
    """No choices."""

    kind: str = "shadows"


class Shadows(TrainableDenoiser):
    """Gives the noisy visibility back."""

    Config = ShadowConfig
    needs = ("visibility",)
    target = "visibility"

    def __init__(self) -> None:
        super().__init__(ShadowConfig())
        self.scale = nn.Parameter(torch.ones(()))

    def forward(self, visibility: Tensor) -> tuple[Tensor]:
        """(image,)."""
        return (self.scale * visibility,)


class Painter(nn.Module, Denoiser):
    """Its image is its target's channel."""

    def __init__(self, target: str) -> None:
        super().__init__()
        self.target, self.needs = target, (target,)

    def step(self, frame: Frame, state: None, extras: tuple[str, ...] = ()) -> tuple[Result, None]:
        return Result(frame[self.target]), None


@pytest.mark.parametrize("name", TARGETS)
def test_light_is_exposed_and_a_share_is_not(name: str) -> None:
    target = Target(name)
    channels = {name: torch.full((1, len(CHANNELS[name].components), 2, 3), 0.5)}
    channels |= {target.reference: channels[name] / 2, "albedo": torch.full((1, 3, 2, 3), 0.5)}
    exposed = [
        [channels | {"exposure": torch.tensor([exposure]), "depth_scale": torch.ones(1)}] for exposure in (1.0, 2.0)
    ]
    once, twice = (SequenceLoss(Painter(name), LossConfig(space="linear"))(batch, 0.0)[0] for batch in exposed)
    assert once == 0.25
    assert twice == (0.5 if target.is_radiance else 0.25)


def test_irradiance_is_that_of_the_light_s_own_texture() -> None:
    config = LossConfig(irradiance=0.5)
    assert config.channels(Target("color")) == ("reference", "albedo")
    assert config.channels(Target("indirect")) == ("reference_indirect", "diffuse_albedo")
    assert LossConfig().channels(Target("glossy")) == ("reference_glossy",)
    for name in ("glossy", "visibility"):
        with pytest.raises(NteError, match=rf"loss.irradiance is 0.5, but '{name}' has no texture: set it to 0"):
            config.channels(Target(name))


def test_shadows_are_validated_as_they_are(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    frames = [disc_frame(i, (24, 33)) for i in range(2)]
    for frame in frames:
        frame["color"] *= 50  # the exposure of the clip is none of theirs
        frame["visibility"] = rng.random((1, 24, 33), np.float32).astype(np.float16).astype(np.float32)
        frame["reference_visibility"] = np.full((1, 24, 33), 0.25, np.float32)
    found = validate(Shadows(), ValidationSet([Clip(write_clip(tmp_path / "clip", frames))], 1))
    error = frames[1]["visibility"] - 0.25
    assert found.scores["validation_l1"] == pytest.approx(np.abs(error).mean(), rel=1e-5)
    assert found.psnr == pytest.approx(-10 * np.log10(np.square(error).mean()), rel=1e-5)
    assert found.picture.shape == (3, 24, 3 * 33)
