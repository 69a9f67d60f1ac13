"""A plain U-Net that returns the features of every decoder level."""

from collections.abc import Sequence
from itertools import pairwise

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from nte.errors import NteError


class ConvBlock(nn.Sequential):
    """Two 3×3 convolutions, each followed by ReLU: (N, inputs, H, W) → (N, outputs, H, W)."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__(
            nn.Conv2d(inputs, outputs, 3, padding=1),
            nn.ReLU(inplace=True),
            nn.Conv2d(outputs, outputs, 3, padding=1),
            nn.ReLU(inplace=True),
        )


class UNet(nn.Module):
    """An encoder with 2×2 max pooling and a decoder with nearest upsampling and skip connections.

    channels: features per level, finest first; level k works at 1/2^k of the input's size. Image sizes must be
    multiples of 2^(levels − 1).
    """

    def __init__(self, inputs: int, channels: Sequence[int]) -> None:
        super().__init__()
        sources = [inputs, *channels[:-1]]
        self.encoders = nn.ModuleList(ConvBlock(i, o) for i, o in zip(sources, channels, strict=True))
        self.decoders = nn.ModuleList(ConvBlock(skip + below, skip) for skip, below in pairwise(channels))

    def forward(self, features: Tensor) -> list[Tensor]:
        """Compute the decoder features (N, channels[k], H/2^k, W/2^k) of every level k, finest first."""
        skips: list[Tensor] = []
        for encoder in self.encoders:
            features = encoder(F.max_pool2d(features, 2) if skips else features)
            skips.append(features)
        levels = [skips[-1]]
        for skip, decoder in zip(reversed(skips[:-1]), reversed(self.decoders), strict=True):
            upsampled = F.interpolate(levels[0], scale_factor=2, mode="nearest")
            levels.insert(0, decoder(torch.cat([upsampled, skip], 1)))
        return levels


def check_levels(channels: Sequence[int]) -> None:
    """Raise NteError, naming the key, for widths of levels that make no network."""
    if not channels or min(channels) < 1:
        raise NteError(f"network.channels is {channels}, expected at least one width of at least 1")


def xavier(module: nn.Module) -> None:
    """Initialise a convolution: Xavier's uniform weights, and no bias (Glorot and Bengio 2010)."""
    if isinstance(module, nn.Conv2d):
        nn.init.xavier_uniform_(module.weight)
        if module.bias is not None:
            nn.init.zeros_(module.bias)
