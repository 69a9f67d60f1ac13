"""What a network is trained towards: the reference of its target, and how images of it are compared and shown."""

from typing import NamedTuple

from torch import Tensor

from nte.color import compress, display, per_sequence
from nte.frames.channels import CHANNELS, reference_of

# What the light of a target has been multiplied with: for `loss.irradiance`.
_TEXTURES = {"color": "albedo", "indirect": "diffuse_albedo"}


class Target(NamedTuple):
    """A channel that networks approximate; `color` is one of them."""

    name: str

    @property
    def reference(self) -> str:
        """The channel that its images are compared with."""
        return reference_of(self.name)

    @property
    def texture(self) -> str | None:
        """The channel by which its light is divided to see it without texture; None where that is none."""
        return _TEXTURES.get(self.name)

    @property
    def is_radiance(self) -> bool:
        """Whether it has an exposure; other targets are shares in [0, 1]."""
        return CHANNELS[self.name].kind == "radiance"

    def in_space(self, image: Tensor, exposure: Tensor, space: str) -> Tensor:
        """An image (N, C, H, W) in the space where losses are measured: linear, log or display; a share as it is."""
        return to_space(image, exposure, space) if self.is_radiance else image

    def displayed(self, image: Tensor, exposure: Tensor) -> Tensor:
        """An image (N, C, H, W) in [0, 1], as it is shown and scored. exposure: (N,)."""
        return display(image, exposure) if self.is_radiance else image.clamp(0, 1)


def to_space(radiance: Tensor, exposure: Tensor, space: str) -> Tensor:
    """Radiance (N, 3, H, W) in the space where losses are measured: linear, log or display. exposure: (N,)."""
    if space == "display":
        return display(radiance, exposure)
    exposed = radiance * per_sequence(exposure)
    return compress(exposed) if space == "log" else exposed
