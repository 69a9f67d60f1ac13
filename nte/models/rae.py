"""The recurrent autoencoder: hidden states at every level of the encoder, and the image predicted directly.

Chaitanya et al. 2017, «Interactive Reconstruction of Monte Carlo Image Sequences Using a Recurrent Denoising
Autoencoder». There are no motion vectors: the hidden states stay where they are in the image.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from types import MappingProxyType

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from nte.color import per_sequence
from nte.frames.usable import BRIGHTEST
from nte.models.filtering import padded
from nte.models.reading import LightConfig, Reader
from nte.models.trainable import TrainableDenoiser
from nte.models.unet import check_levels, xavier
from nte.recurrence import Recurrent

SLOPE = 0.1  # of the leaky ReLUs, below 0


@dataclass
class RaeConfig(LightConfig):
    """Settings of the network; the defaults are the paper's widths."""

    kind: str = "rae"
    channels: list[int] = field(default_factory=lambda: [32, 43, 57, 76, 101, 101])  # per level, finest first

    def check(self) -> None:
        """Raise NteError, naming the key, for values that make no network."""
        super().check()
        check_levels(self.channels)


class RecurrentAutoencoder(TrainableDenoiser):
    """A recurrent autoencoder for one kind of light. The state holds one hidden image per level.

    Hidden images are learned and have no unit: a change of the exposure is a change of the light to them.
    """

    Config = RaeConfig
    conventions = MappingProxyType(
        {
            "exposure": "(N,), 0.18 / exp(mean log luminance of the first frame), constant over a sequence: what is "
            "carried cannot follow a change"
        }
    )
    config: RaeConfig
    inputs: tuple[str, ...] = ()  # depends on the settings

    def __init__(self, config: RaeConfig) -> None:
        super().__init__(config)
        self.reading = Reader(config.target, tuple(config.inputs), config.demodulate)
        self.target, self.needs, self.optional = config.target, self.reading.needs, self.reading.measured
        self.recurrent = {f"hidden_{k}": Recurrent(f"next_hidden_{k}", c, 2**k) for k, c in enumerate(config.channels)}
        self.inputs = (*self.needs, "reset", *self.reading.scalars, *self.recurrent)
        self.encoder = Encoder(self.reading.width, config.channels)
        self.decoder = Decoder(config.channels, self.reading.components)
        self.apply(xavier)

    def forward(self, *tensors: Tensor) -> tuple[Tensor, ...]:
        """Denoise one frame: `inputs`, in order → the image and the next hidden states.

        Images (N, C, H, W) of any size from 16; the hidden state of level k (N, C_k, ⌈H/2^k⌉, ⌈W/2^k⌉); reset, exposure
        and depth_scale (N,). Where reset is 1 the hidden states count as 0.
        """
        given = dict(zip(self.inputs, tensors, strict=True))
        seen = self.reading(given)
        height, width = seen.light.shape[-2:]
        continues = per_sequence(given["reset"]) == 0
        before = [torch.where(continues, given[name], 0.0) for name in self.recurrent]
        levels = self.encoder(padded(seen.features, 2 ** (len(before) - 1)), before)
        predicted = self.decoder(levels)[..., :height, :width].float()
        sizes = [hidden.shape[-2:] for hidden in before]
        hidden = [level[..., : size[0], : size[1]].float() for level, size in zip(levels, sizes, strict=True)]
        return self.reading.image(self._light(predicted), seen), *hidden

    def _light(self, predicted: Tensor) -> Tensor:
        """Light (N, C, H, W) out of what the decoder predicts: the compressed light, which may leave its range.

        The gradient passes the clamp as it is. Most light is dark: behind a clamp that lets none through below 0, or
        little (softplus), every seed ended as a black image.
        """
        if not self.reading.is_radiance:
            return predicted.sigmoid()
        clamped = predicted.clamp(0, math.log1p(BRIGHTEST))
        return (predicted + (clamped - predicted).detach()).exp() - 1


class RecurrentBlock(nn.Module):
    """A convolution of the features, and two of them with the hidden state: the result is the next hidden state."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.first = _convolution(inputs, outputs)
        self.second = _convolution(2 * outputs, outputs)
        self.third = _convolution(outputs, outputs)

    def forward(self, features: Tensor, hidden: Tensor) -> Tensor:
        """Compute the next hidden state (N, outputs, H, W); `hidden` may lack rows and columns, which then repeat."""
        features = self.first(features)
        down, across = (features.shape[axis] - hidden.shape[axis] for axis in (-2, -1))
        hidden = F.pad(hidden, (0, across, 0, down), mode="replicate")
        hidden = self.third(self.second(torch.cat([features, hidden], 1)))
        return hidden


class Encoder(nn.Module):
    """The step with a recurrent block per level and 2×2 max pooling between levels."""

    def __init__(self, inputs: int, channels: Sequence[int]) -> None:
        super().__init__()
        self.blocks = nn.ModuleList(RecurrentBlock(i, o) for i, o in pairwise([inputs, *channels]))

    def forward(self, features: Tensor, hidden: list[Tensor]) -> list[Tensor]:
        """Compute the hidden states of every level, finest first. Sizes are multiples of 2^(levels − 1)."""
        levels: list[Tensor] = []
        for block, before in zip(self.blocks, hidden, strict=True):
            levels.append(block(F.max_pool2d(levels[-1], 2) if levels else features, before))
        return levels


class Decoder(nn.Module):
    """The step that goes from the coarsest level to the image, with nearest upsampling and skip connections."""

    def __init__(self, channels: Sequence[int], outputs: int) -> None:
        super().__init__()
        self.blocks = nn.ModuleList(
            nn.Sequential(_convolution(skip + below, skip), _convolution(skip, skip))
            for skip, below in pairwise(channels)
        )
        self.last = nn.Conv2d(channels[0], outputs, 3, padding=1)

    def forward(self, levels: list[Tensor]) -> Tensor:
        """Compute the predicted image (N, outputs, H, W). levels: finest first."""
        features = levels[-1]
        for skip, block in zip(reversed(levels[:-1]), reversed(self.blocks), strict=True):
            features = block(torch.cat([F.interpolate(features, scale_factor=2, mode="nearest"), skip], 1))
        predicted: Tensor = self.last(features)
        return predicted


def _convolution(inputs: int, outputs: int) -> nn.Sequential:
    return nn.Sequential(nn.Conv2d(inputs, outputs, 3, padding=1), nn.LeakyReLU(SLOPE))
