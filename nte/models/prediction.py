"""The prediction of kernels: a U-Net, and heads that read its decoder features at several scales."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from nte.errors import NteError, expected_one_of
from nte.models.kernels import Downsample
from nte.models.trainable import NetworkConfig
from nte.models.unet import check_levels

LARGEST = 15.0  # of the logarithm of a weight
TAPS = 11  # that are mixed: 3×3 pixels of half the resolution, the pixel itself, and its history; a prior is one more


@dataclass
class KernelConfig(NetworkConfig):
    """Settings that all networks share which predict kernels; the defaults are the paper's, where it states them."""

    channels: list[int] = field(default_factory=lambda: [32, 48, 64, 80, 96])  # U-Net, finest level first
    front: int = 1  # stride of the U-Net's first convolution; 2 makes it work at half resolution
    scales: int = 3  # kernels at full, 1/2 and 1/4 resolution; 1 is a single-scale network
    kernel_size: int = 5
    head_size: int = 3  # of the convolutions that predict kernels
    downsample: str = "max"  # D of Eq. 4: max (the paper's text) or mean (Vogels et al. 2018)
    motion: str = "dual"  # dual or traditional

    def check(self) -> None:
        """Raise NteError, naming the key, for values that make no network."""
        super().check()
        choices = {"downsample": ("max", "mean"), "motion": ("dual", "traditional"), "front": (1, 2, 4)}
        for key, allowed in choices.items():
            if getattr(self, key) not in allowed:
                found = getattr(self, key)
                raise NteError(f"network.{key} is {found!r}{expected_one_of(found, allowed)}")
        if any(size % 2 == 0 or size < 1 for size in (self.kernel_size, self.head_size)):
            raise NteError("network.kernel_size and network.head_size must be odd")
        check_levels(self.channels)
        if self.scales < 1 or max(0, self.scales - self.front.bit_length()) >= len(self.channels):
            raise NteError(f"network.scales is {self.scales}: network.channels has {len(self.channels)} levels")

    @property
    def pooling(self) -> Downsample:
        """What `downsample` says, of the type that the steps take."""
        return "max" if self.downsample == "max" else "mean"

    @property
    def multiple(self) -> int:
        """The number to whose multiples the image's height and width are padded."""
        return max(self.front << (len(self.channels) - 1), 1 << (self.scales - 1))


class ScaleKernels(NamedTuple):
    """What a head predicts for one scale: positive weights (N, K·K, H, W), and α (N, 1, H, W) in (0, 1)."""

    spatial: Tensor | None  # None at the finest scale if it mixes
    alpha: Tensor | None  # weight of this scale in the next finer one; at the finest, of the frame against history
    temporal: Tensor | None  # of the warped history, at the finest scale
    mixing: Tensor | None = None  # (N, taps·4, H/2, W/2), at the finest scale: weights of nte.models.filtering.Mixing


class KernelHeads(nn.Module):
    """Convolutions that predict the kernels of each scale from the decoder level of that scale.

    51 = 25 + 25 + α channels at the finest scale and 26 = 25 + α at the others, for 5×5 kernels (Fig. 6). Behind a
    front, a head predicts front² pixels at once.
    """

    def __init__(
        self, channels: Sequence[int], front: int, scales: int, kernel_size: int, head_size: int, temporal: bool,
        mixing: int = 0,
    ) -> None:  # fmt: skip
        """Make the heads. mixing: number of images that the finest scale mixes; 0 gives it kernels."""
        super().__init__()
        self.taps, self.temporal, self.mixing = kernel_size**2, temporal, mixing
        front_levels = front.bit_length() - 1
        self.shuffles = [2 ** max(0, front_levels - scale) for scale in range(scales)]
        self.levels = [max(0, scale - front_levels) for scale in range(scales)]
        # At the finest scale α weighs the frame against history: without a temporal kernel there is none.
        outputs = [1 + self.taps] * scales
        outputs[0] = 1 + 2 * self.taps if temporal else self.taps
        if mixing:  # the first scale with kernels is then the finest that is combined, so it has no α
            outputs[:2], self.shuffles[0] = [mixing * front**2, self.taps], 1
        self.heads = nn.ModuleList(
            nn.Conv2d(channels[level], n * shuffle**2, head_size, padding=head_size // 2)
            for level, n, shuffle in zip(self.levels, outputs, self.shuffles, strict=True)
        )

    def prefer(self, tap: int, logarithm: float) -> None:
        """Begin with a larger weight of one of the mixed images."""
        bias = self.heads[0].bias
        assert isinstance(bias, Tensor)
        pixels = len(bias) // self.mixing
        with torch.no_grad():
            bias[tap * pixels : (tap + 1) * pixels] = logarithm

    def forward(self, levels: list[Tensor]) -> list[ScaleKernels]:
        """Predict the kernels of every scale, finest first. levels: the trunk's features, finest first."""
        predicted = []
        for scale, (head, level, shuffle) in enumerate(zip(self.heads, self.levels, self.shuffles, strict=True)):
            values = head(levels[level]).float()
            values = F.pixel_shuffle(values, shuffle) if shuffle > 1 else values
            if self.mixing and scale == 0:
                predicted.append(ScaleKernels(None, None, None, weights(values)))
                continue
            blended = scale == 0 and self.temporal
            weighed = int(blended or scale > bool(self.mixing))
            # A split has one backward pass for all parts; that of each slice would write zeros for the others.
            alphas, spatial, temporal = values.split([weighed, self.taps, self.taps * blended], 1)
            alpha = alphas.sigmoid() if weighed else None
            predicted.append(ScaleKernels(weights(spatial), alpha, weights(temporal) if blended else None))
        return predicted


def weights(values: Tensor) -> Tensor:
    """Turn numbers into positive weights from e⁻¹⁵ to e¹⁵: a softmax in effect, as `average` divides by their sum.

    Softmax over channels is slow in ONNX Runtime: it took two thirds of a frame.
    """
    return values.clamp(-LARGEST, LARGEST).exp()


class Memory(nn.Module):
    """A 1×1 convolution of the finest decoder features to features in (−1, 1) that are carried to the next frame."""

    def __init__(self, inputs: int, front: int, features: int) -> None:
        super().__init__()
        self.front = front
        self.remember = nn.Conv2d(inputs, features * front**2, 1)

    def forward(self, finest: Tensor) -> Tensor:
        """Compute the features (N, features, H, W) at the image's size."""
        # Bounded, since what is fed back in every frame could grow without end over a long sequence.
        values = self.remember(finest).float().tanh()
        return F.pixel_shuffle(values, self.front) if self.front > 1 else values
