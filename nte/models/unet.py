"""A plain U-Net that returns the features of every decoder level."""

from collections.abc import Sequence
from itertools import pairwise

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from nte.errors import NteError
from nte.models.kernels import is_tracing


class ByFours(nn.Conv2d):
    """A convolution of any number of features, which in a traced graph come by fours, the last of them 0.

    ONNX Runtime has a fast one for those: at 1280×720 it takes 33 ms for 24 features, and 52 for 21.
    """

    def forward(self, features: Tensor) -> Tensor:
        """Convolve features (N, C, H, W)."""
        more = -self.in_channels % 4
        if not more or not is_tracing():
            return super().forward(features)
        features = torch.cat([features, torch.zeros_like(features[:, :more])], 1)
        weight = torch.cat([self.weight, torch.zeros(self.out_channels, more, *self.kernel_size)], 1)
        return F.conv2d(features, weight, self.bias, self.stride, self.padding)


class ConvBlock(nn.Sequential):
    """Two convolutions, each followed by ReLU: (N, inputs, H, W) → (N, outputs, H/stride, W/stride).

    The second is 3×3, and the first as well, of pixels at the stride. So with a stride it is what a 3×3 convolution is
    behind a pixel-unshuffle, without the copy: ONNX Runtime takes twice as long for the two.
    """

    def __init__(self, inputs: int, outputs: int, stride: int = 1) -> None:
        super().__init__(
            ByFours(inputs, outputs, 3 * stride, stride, padding=stride),
            nn.ReLU(inplace=True),
            nn.Conv2d(outputs, outputs, 3, padding=1),
            nn.ReLU(inplace=True),
        )


class UNet(nn.Module):
    """An encoder with 2×2 max pooling and a decoder with nearest upsampling and skip connections.

    channels: features per level, finest first. front: level k works at 1/(front·2^k) of the input's size. Image sizes
    must be multiples of front·2^(levels − 1).
    """

    def __init__(self, inputs: int, channels: Sequence[int], front: int = 1) -> None:
        super().__init__()
        finest = ConvBlock(inputs, channels[0], front)
        self.encoders = nn.ModuleList([finest, *(ConvBlock(i, o) for i, o in pairwise(channels))])
        self.decoders = nn.ModuleList(ConvBlock(skip + below, skip) for skip, below in pairwise(channels))

    def forward(self, features: Tensor) -> list[Tensor]:
        """Compute the decoder features (N, channels[k], H/(front·2^k), W/(front·2^k)) of level k, finest first."""
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
