"""The paper's network: multi-scale and temporal kernel prediction with dual motion vectors.

Zeng et al., «Neural Temporal Denoising for Indirect Illumination». Whatever the text leaves open is a setting, which
`TemporalConfig` documents.
"""

from dataclasses import dataclass, field
from types import MappingProxyType
from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from nte.color import compress, divisor, per_sequence
from nte.errors import NteError
from nte.frames.usable import (
    BRIGHTEST,
    usable_depth,
    usable_direction,
    usable_radiance,
    usable_reflectance,
    usable_vector,
)
from nte.models.kernels import apply_kernels, combine_scales
from nte.models.trainable import NetworkConfig, TrainableDenoiser
from nte.models.unet import UNet
from nte.motion.geometric import dual_motion, traditional_motion
from nte.motion.warp import warp
from nte.recurrence import FORWARD, Recurrent


@dataclass
class TemporalConfig(NetworkConfig):
    """Settings of the network; the defaults are the paper's, where it states them."""

    kind: str = "temporal"
    channels: list[int] = field(default_factory=lambda: [32, 48, 64, 80, 96])  # U-Net, finest level first
    front: int = 1  # factor of a pixel-unshuffle before the U-Net; 2 makes it work at half resolution
    scales: int = 3  # kernels at full, 1/2 and 1/4 resolution; 1 is a single-scale network
    kernel_size: int = 5
    head_size: int = 3  # of the convolutions that predict kernels
    downsample: str = "max"  # D of Eq. 4: max (the paper's text) or mean (Vogels et al. 2018)
    temporal: bool = True  # false: no temporal kernel and no history
    motion: str = "dual"  # dual or traditional
    feed_warped: bool = True  # the warped previous output is an input of the network
    feed_masks: bool = False  # the history's validity and the disocclusion mask are inputs too (not in the paper)
    demodulate: bool = False  # filter irradiance and multiply the result by the albedo (not in the paper)

    def check(self) -> None:
        """Raise NteError, naming the key, for values that make no network."""
        choices = {"downsample": ("max", "mean"), "motion": ("dual", "traditional"), "front": (1, 2, 4)}
        for key, allowed in choices.items():
            if getattr(self, key) not in allowed:
                raise NteError(f"network.{key} is {getattr(self, key)!r}, expected one of {allowed}")
        if any(size % 2 == 0 or size < 1 for size in (self.kernel_size, self.head_size)):
            raise NteError("network.kernel_size and network.head_size must be odd")
        if not self.channels or min(self.channels) < 1:
            raise NteError(f"network.channels is {self.channels}, expected at least one width of at least 1")
        deepest = max(0, self.scales - self.front.bit_length())
        if self.scales < 1 or deepest >= len(self.channels):
            raise NteError(f"network.scales is {self.scales}: network.channels has {len(self.channels)} levels")


class Denoised(NamedTuple):
    """Outputs of the graph: the image in the input's units, the next history, and masks and weights for inspection."""

    image: Tensor
    next_history: Tensor
    disoccluded: Tensor  # (N, 1, H, W), 0 or 1
    valid: Tensor  # (N, 1, H, W), 0 or 1
    alpha: Tensor  # (N, 1, H, W), weight of the current frame


class KernelHeads(nn.Module):
    """Convolutions that predict K·K spatial weights and α for each scale, and K·K temporal weights for the finest."""

    def __init__(self, config: TemporalConfig) -> None:
        super().__init__()
        self.taps = config.kernel_size**2
        front_levels = config.front.bit_length() - 1
        scales = range(config.scales)
        self.shuffles = [2 ** max(0, front_levels - scale) for scale in scales]
        self.levels = [max(0, scale - front_levels) for scale in scales]
        # 51 = 25 + 25 + α at the finest scale, 26 = 25 + α at the others
        outputs = [1 + self.taps * (2 if config.temporal and scale == 0 else 1) for scale in scales]
        self.heads = nn.ModuleList(
            nn.Conv2d(config.channels[level], n * shuffle**2, config.head_size, padding=config.head_size // 2)
            for level, n, shuffle in zip(self.levels, outputs, self.shuffles, strict=True)
        )

    def forward(self, levels: list[Tensor]) -> list[tuple[Tensor, Tensor, Tensor]]:
        """Predict per scale, finest first: α, the spatial kernel, and the temporal kernel or an empty tensor.

        levels: the U-Net's decoder features, finest first. Kernels (N, K·K, H, W) sum to 1; α (N, 1, H, W) is in
        (0, 1).
        """
        predicted = []
        for head, level, shuffle in zip(self.heads, self.levels, self.shuffles, strict=True):
            values = head(levels[level]).float()
            values = F.pixel_shuffle(values, shuffle) if shuffle > 1 else values
            spatial, temporal = values[:, 1 : 1 + self.taps], values[:, 1 + self.taps :]
            predicted.append((values[:, :1].sigmoid(), spatial.softmax(1), temporal.softmax(1)))
        return predicted


class TemporalDenoiser(TrainableDenoiser):
    """A recurrent, kernel-predicting denoiser of `color`.

    The state holds the last output, exposed, and demodulated if so configured, and the last depth.
    """

    Config = TemporalConfig
    extras = ("disoccluded", "valid", "alpha")
    recurrent = MappingProxyType({"history": Recurrent("next_history", 3), "previous_depth": Recurrent("depth", 1)})
    config: TemporalConfig

    def __init__(self, config: TemporalConfig) -> None:
        super().__init__(config)
        self.needs: tuple[str, ...] = ("color", "albedo", "normal", "depth", "motion")
        self.optional: tuple[str, ...] = (FORWARD,) if config.motion == "dual" else ()
        inputs = 3 + 3 + 3 + 1 + (3 if config.feed_warped and config.temporal else 0) + (2 if config.feed_masks else 0)
        self.unet = UNet(inputs * config.front**2, config.channels)
        self.heads = KernelHeads(config)
        self.apply(_xavier)

    @property
    def multiple(self) -> int:
        """The number to whose multiples `forward` pads the image's height and width."""
        levels, scales = len(self.config.channels), self.config.scales
        return max(self.config.front << (levels - 1), 1 << (scales - 1))

    def forward(
        self, color: Tensor, albedo: Tensor, normal: Tensor, depth: Tensor, motion: Tensor,
        previous_forward_motion: Tensor, reset: Tensor, exposure: Tensor, depth_scale: Tensor,
        history: Tensor, previous_depth: Tensor,
    ) -> Denoised:  # fmt: skip
        """Denoise one frame of plain tensors, with all conventions inside: this is the exported graph.

        Images (N, C, H, W) of any size from 16; reset, exposure and depth_scale (N,). Where reset is 1 the history is
        ignored, and the noisy image takes the place of the warped previous one.
        """
        config = self.config
        scale = per_sequence(exposure)
        albedo, depth, motion = usable_reflectance(albedo), usable_depth(depth), usable_vector(motion)
        light = usable_radiance(color * scale, BRIGHTEST)
        texture = divisor(albedo) if config.demodulate else None
        light = light if texture is None else light / texture

        if config.motion == "dual":
            forward = usable_vector(previous_forward_motion)
            vectors = dual_motion(motion, forward, depth, usable_depth(previous_depth))
        else:
            vectors = traditional_motion(motion)
        continues = per_sequence(reset) == 0
        valid, disoccluded = vectors.valid & continues, vectors.disoccluded & continues
        warped = warp(history, vectors.motion).image
        valid = valid & (warped.abs() < float("inf")).all(1, keepdim=True)
        warped = torch.where(valid, warped, light)

        features = [compress(light), albedo, usable_direction(normal), _normalised(depth, depth_scale)]
        if config.feed_warped and config.temporal:
            features.append(compress(warped))
        if config.feed_masks:
            features += [valid.to(light.dtype), disoccluded.to(light.dtype)]
        # On the first frame the noisy image replaces the warped one everywhere, as in the paper.
        warped = torch.cat([warped, (valid | ~continues).to(light.dtype)], 1)
        filtered, alpha = self._filter(torch.cat(features, 1), light, warped)
        image = filtered if texture is None else filtered * texture
        return Denoised(image / scale, filtered, disoccluded.float(), valid.float(), alpha)

    def _filter(self, features: Tensor, light: Tensor, warped: Tensor) -> tuple[Tensor, Tensor]:
        """Predict kernels from the features and apply them; returns the filtered light ≥ 0 and α of the last blend.

        warped (N, 4, H, W): the previous output, and a mask that is 1 where the temporal kernels may read it, else 0.
        """
        config = self.config
        height, width = light.shape[-2:]
        pad = (0, -width % self.multiple, 0, -height % self.multiple)
        features, light, warped = (F.pad(x, pad, mode="replicate") for x in (features, light, warped))
        front = F.pixel_unshuffle(features, config.front) if config.front > 1 else features
        predicted = self.heads(self.unet(front))
        pyramid = [light]
        for _ in range(config.scales - 1):
            pyramid.append(F.avg_pool2d(pyramid[-1], 2))
        filtered = [apply_kernels(image, spatial) for image, (_, spatial, _) in zip(pyramid, predicted, strict=True)]
        output = filtered[-1]
        for fine, (alpha, _, _) in zip(reversed(filtered[:-1]), reversed(predicted[1:]), strict=True):
            output = combine_scales(fine, output, alpha, "max" if config.downsample == "max" else "mean")
        output = output.clamp(min=0)  # before blending, compression and storage, since Eq. 4 may go negative
        alpha, _, temporal = predicted[0]
        if config.temporal:
            history, known = _apply_masked(warped[:, :3], warped[:, 3:], temporal)
            alpha = torch.where(known, alpha, 1.0)
            output = alpha * output + (1 - alpha) * history  # Eq. 1
        return output[..., :height, :width], alpha[..., :height, :width]


_LEAST_WEIGHT = 1e-12  # a kernel with less total weight on the pixels that it may read has selected only others


def _apply_masked(image: Tensor, weight: Tensor, kernels: Tensor) -> tuple[Tensor, Tensor]:
    """Apply kernels to the pixels whose weight (N, 1, H, W) is 1 rather than 0, and renormalise the kernels.

    Returns the image, and (N, 1, H, W) bool, true where a kernel had anything to read; elsewhere the image is 0.
    """
    summed = apply_kernels(torch.cat([image * weight, weight], 1), kernels)
    total = summed[:, 3:]
    known = total > _LEAST_WEIGHT
    return summed[:, :3] / torch.where(known, total, 1.0) * known, known


def _normalised(depth: Tensor, depth_scale: Tensor) -> Tensor:
    """Depth (N, 1, H, W) mapped to [0, 1] by d / (d + scale): ½ at the scale, 1 for the sky, which is stored as 0."""
    return torch.where(depth > 0, depth / (depth + per_sequence(depth_scale)), 1.0)


def _xavier(module: nn.Module) -> None:
    if isinstance(module, nn.Conv2d):
        nn.init.xavier_uniform_(module.weight)
        if module.bias is not None:
            nn.init.zeros_(module.bias)
