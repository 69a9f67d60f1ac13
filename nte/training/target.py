"""The target of training: a channel, its reference, and how its images are compared and shown."""

from typing import NamedTuple

from torch import Tensor

from nte.color import compress, display, per_sequence
from nte.frames.channels import CHANNELS, TEXTURES, reference_of


class Target(NamedTuple):
    """A channel whose reference networks approximate, such as `color`."""

    name: str

    @property
    def reference(self) -> str:
        """The channel that its images are compared with."""
        return reference_of(self.name)

    @property
    def texture(self) -> str | None:
        """The channel by which its light is divided to remove texture; None if there is none."""
        return TEXTURES.get(self.name)

    @property
    def is_radiance(self) -> bool:
        """Whether it is radiance, which has an exposure; other targets are shares in [0, 1]."""
        return CHANNELS[self.name].kind == "radiance"

    def in_space(self, image: Tensor, exposure: Tensor, space: str) -> Tensor:
        """Convert an image (N, C, H, W) to a space of losses, linear, log or display; a share stays as it is.

        exposure: (N,).
        """
        return to_space(image, exposure, space) if self.is_radiance else image

    def displayed(self, image: Tensor, exposure: Tensor) -> Tensor:
        """Convert an image (N, C, H, W) to [0, 1], as it is shown and scored. exposure: (N,)."""
        return display(image, exposure) if self.is_radiance else image.clamp(0, 1)


def to_space(radiance: Tensor, exposure: Tensor, space: str) -> Tensor:
    """Convert radiance (N, 3, H, W) to a space of losses: linear, log or display. exposure: (N,).

    linear is exposed radiance, log is log(1 + exposed), and display is in [0, 1].
    """
    if space == "display":
        return display(radiance, exposure)
    exposed = radiance * per_sequence(exposure)
    return compress(exposed) if space == "log" else exposed
