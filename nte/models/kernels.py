"""Filtering with predicted kernels, one per pixel, and combining the scales of an image."""

import math
from collections.abc import Iterator
from typing import Any, Literal

import torch
import torch.nn.functional as F
from torch import Tensor
from torch.autograd.function import once_differentiable

Downsample = Literal["max", "mean"]


def apply_kernels(image: Tensor, kernels: Tensor) -> Tensor:
    """Filter an image (N, C, H, W) with one kernel per pixel, kernels (N, K·K, H, W), taps row by row.

    The border repeats, so kernels that sum to 1 keep a constant image constant. Differentiable once.
    """
    padded = F.pad(image, [math.isqrt(int(kernels.shape[1])) // 2] * 4, mode="replicate")
    # A traced graph needs the plain operators, and inference has nothing to save for a backward pass.
    if torch.is_grad_enabled() and not is_tracing():
        filtered: Tensor = _ApplyKernels.apply(padded, kernels)  # type: ignore[no-untyped-call]
        return filtered
    return _sum_of_taps(padded, kernels)


def average(image: Tensor, weights: Tensor) -> Tensor:
    """Average an image (N, C, H, W) around each pixel with positive weights (N, K·K, H, W), taps row by row.

    A constant image stays constant, whatever the weights sum to.
    """
    return apply_kernels(image, weights) / weights.sum(1, keepdim=True)


def around(image: Tensor, kernels: Tensor) -> Tensor:
    """Gather what each tap of kernels (N, K·K, H, W) reads of an image (N, 1, H, W), as (N, K·K, H, W)."""
    padded = F.pad(image, [math.isqrt(int(kernels.shape[1])) // 2] * 4, mode="replicate")
    return torch.cat([padded[:, :, rows, columns] for rows, columns in _windows(padded, kernels)], 1)


class _ApplyKernels(torch.autograd.Function):
    """The sum over taps, with its own backward pass.

    The automatic backward pass of slices writes a padded image of zeros for each tap, which is slow.
    """

    @staticmethod
    def forward(ctx: Any, padded: Tensor, kernels: Tensor) -> Tensor:
        ctx.save_for_backward(padded, kernels)
        return _sum_of_taps(padded, kernels)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor | None, Tensor | None]:
        padded, kernels = ctx.saved_tensors
        wants_image, wants_kernels = ctx.needs_input_grad
        of_image = torch.zeros_like(padded) if wants_image else None
        of_kernels = torch.zeros_like(kernels) if wants_kernels else None
        for tap, (rows, columns) in enumerate(_windows(padded, kernels)):
            if of_image is not None:
                of_image[:, :, rows, columns].addcmul_(kernels[:, tap : tap + 1], grad)
            if of_kernels is not None:
                for component in range(grad.shape[1]):  # one product of all components and a sum take twice the time
                    of_kernels[:, tap].addcmul_(padded[:, component, rows, columns], grad[:, component])
        return of_image, of_kernels


def _sum_of_taps(padded: Tensor, kernels: Tensor) -> Tensor:
    """The sum of kernel × shifted image: a loop over the K² taps, since an unfold would hold K²·C images at once."""
    height, width = kernels.shape[-2:]
    filtered = torch.zeros_like(padded[:, :, :height, :width])
    for tap, (rows, columns) in enumerate(_windows(padded, kernels)):
        weight, shifted = kernels[:, tap : tap + 1], padded[:, :, rows, columns]
        # In place it takes a third of the time; in a graph it would become one more product.
        filtered = filtered + weight * shifted if is_tracing() else filtered.addcmul_(weight, shifted)
    return filtered


def is_tracing() -> bool:
    """Whether a graph is made of what is computed now."""
    return torch.jit.is_tracing()  # type: ignore[attr-defined, no-any-return, no-untyped-call]


def _windows(padded: Tensor, kernels: Tensor) -> Iterator[tuple[slice, slice]]:
    """The rows and columns of the padded image that each tap reads, row by row."""
    height, width = kernels.shape[-2:]
    size = math.isqrt(int(kernels.shape[1]))
    for dy in range(size):
        for dx in range(size):
            yield slice(dy, dy + height), slice(dx, dx + width)


def combine_scales(fine: Tensor, coarse: Tensor, alpha: Tensor, downsample: Downsample) -> Tensor:
    """Combine two scales by Eq. 4: o = f − U[α·D(f)] + U[α·c], so that c replaces the low frequencies of f.

    fine f (N, C, 2H, 2W); coarse c (N, C, H, W); alpha α (N, 1, H, W) in [0, 1]. U is bilinear upsampling. D is 2×2 max
    pooling in the paper's text, and the mean in Vogels et al. 2018. The maximum subtracts too much, which darkens the
    image. The result may be below 0 with either, so the caller clamps it.
    """
    pool = F.max_pool2d if downsample == "max" else F.avg_pool2d
    # U is linear, so one upsampling serves both terms.
    change = alpha * (coarse - pool(fine, 2))
    return fine + F.interpolate(change, scale_factor=2, mode="bilinear", align_corners=False)
