"""A network that nte does not know, in one file: indirect light, with features of half the size that it remembers."""

from dataclasses import dataclass
from types import MappingProxyType

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from nte.color import compress, divisor, per_sequence
from nte.errors import NteError
from nte.frames.usable import BRIGHTEST, usable_radiance, usable_reflectance, usable_vector
from nte.models.trainable import NetworkConfig, TrainableDenoiser
from nte.motion.warp import warp
from nte.recurrence import Recurrent


@dataclass
class TinyConfig(NetworkConfig):
    """The choices of a TinyNetwork."""

    kind: str = "tests.tiny_network:TinyNetwork"
    width: int = 4

    def check(self) -> None:
        """Raise NteError for a width that makes no network."""
        if self.width < 1:
            raise NteError(f"network.width is {self.width}, expected at least 1")


class TinyNetwork(TrainableDenoiser):
    """Mixes a blurred image with the warped last one; how much, it reads from the light and from its features."""

    Config = TinyConfig
    needs = ("indirect", "diffuse_albedo", "motion")
    optional = ("emission", "color")  # color: the exposure is measured from it
    target = "indirect"
    extras = ("alpha",)
    recurrent = MappingProxyType(
        {
            "irradiance": Recurrent("next_irradiance", 3),
            "features": Recurrent("next_features", 4, scale=2),
            "previous_exposure": Recurrent("exposure", 0),
        }
    )
    conventions = MappingProxyType({"alpha": "weight of the current frame"})
    config: TinyConfig

    def __init__(self, config: TinyConfig) -> None:
        super().__init__(config)
        self.down = nn.Conv2d(3 + 3 + 4, config.width, 3, stride=2, padding=1)
        self.remember = nn.Conv2d(config.width, 4, 1)
        self.weigh = nn.Conv2d(config.width, 1, 1)

    def forward(
        self, indirect: Tensor, diffuse_albedo: Tensor, motion: Tensor, reset: Tensor, exposure: Tensor,
        irradiance: Tensor, features: Tensor, previous_exposure: Tensor, emission: Tensor | None = None,
    ) -> tuple[Tensor, ...]:  # fmt: skip
        """(image, next_irradiance, next_features, alpha)."""
        texture = divisor(usable_reflectance(diffuse_albedo))
        light = usable_radiance(indirect * per_sequence(exposure), BRIGHTEST) / texture
        continues = per_sequence(reset) == 0
        irradiance = irradiance * torch.where(continues, per_sequence(exposure / previous_exposure), 1.0)
        past = warp(irradiance, usable_vector(motion)).image
        known = continues & (past.abs() < float("inf")).all(1, keepdim=True)
        past = torch.where(known, past, light)
        lamp = torch.zeros_like(light) if emission is None else usable_radiance(emission, BRIGHTEST)
        size = light.shape[-2:]
        remembered = F.interpolate(torch.where(continues, features, 0.0), scale_factor=2)[..., : size[0], : size[1]]
        seen = self.down(torch.cat([compress(light), compress(lamp), remembered], 1)).relu()
        alpha = F.interpolate(self.weigh(seen).float(), scale_factor=2)[..., : size[0], : size[1]].sigmoid()
        alpha = torch.where(known, alpha, 1.0)
        mixed = alpha * F.avg_pool2d(F.pad(light, [1] * 4, mode="replicate"), 3, stride=1) + (1 - alpha) * past
        return mixed * texture / per_sequence(exposure), mixed, self.remember(seen).float().tanh(), alpha
