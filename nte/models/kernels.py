"""Applying predicted kernels, and combining scales with them."""

import math
from typing import Literal

import torch
import torch.nn.functional as F
from torch import Tensor

Downsample = Literal["max", "mean"]


def apply_kernels(image: Tensor, kernels: Tensor) -> Tensor:
    """Filter image (N, C, H, W) with one kernel per pixel, kernels (N, K·K, H, W), row by row.

    The border repeats, so kernels that sum to one keep a constant constant. A loop over the K² taps: an
    unfold would hold K²·C images at once.
    """
    size = math.isqrt(int(kernels.shape[1]))
    height, width = image.shape[-2:]
    padded = F.pad(image, [size // 2] * 4, mode="replicate")
    filtered = torch.zeros_like(image)
    for tap in range(size * size):
        dy, dx = divmod(tap, size)
        filtered = filtered + kernels[:, tap : tap + 1] * padded[:, :, dy : dy + height, dx : dx + width]
    return filtered


def combine_scales(fine: Tensor, coarse: Tensor, alpha: Tensor, downsample: Downsample) -> Tensor:
    """Eq. 4: o = f − U[α·D(f)] + U[α·c]: the coarse image replaces the low frequencies of the fine one.

    fine (N, C, 2H, 2W); coarse (N, C, H, W); alpha (N, 1, H, W) in [0, 1]. U is bilinear; D is 2×2 max
    pooling in the paper's text and the mean in Vogels et al. 2018. The maximum takes away more than it
    should, which darkens; both may go below zero, so the caller clamps.
    """
    pool = F.max_pool2d if downsample == "max" else F.avg_pool2d
    # U is linear: one upsampling serves both terms.
    change = alpha * (coarse - pool(fine, 2))
    return fine + F.interpolate(change, scale_factor=2, mode="bilinear", align_corners=False)
