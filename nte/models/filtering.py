"""The steps that apply predicted kernels to light and history, and blend the results."""

from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from nte.models.kernels import Downsample, apply_kernels, average, combine_scales, is_tracing
from nte.models.prediction import ScaleKernels

_AROUND = 9  # pixels of half the resolution
LEAST_WEIGHT = 1e-12  # a kernel with less total weight on the pixels that it may read has selected only others


class Filtered(NamedTuple):
    """Filtered images, before they are blended."""

    scales: list[Tensor]  # (N, C, H/2^k, W/2^k), finest first; without the finest if it mixes
    own: list[Tensor]  # (N, C, H, W): the light as it was, and the prior if there is one
    history: Tensor | None  # (N, C, H, W)
    known: Tensor | None  # (N, 1, H, W) bool: the temporal kernel had a pixel to read


class KernelApplication(nn.Module):
    """The step that filters each scale of the light with its spatial kernels, and the history with the temporal ones.

    Costs K²·C multiply-adds per pixel of each scale, and K²·(C + 1) more for the history: for 5×5 kernels, 3 scales
    and 3 components 98 and 100 per pixel. A finest scale that mixes has no kernels, and history stays as it is.
    """

    def forward(
        self, light: Tensor, kernels: list[ScaleKernels], history: Tensor | None, readable: Tensor | None,
        prior: Tensor | None = None,
    ) -> Filtered:  # fmt: skip
        """Filter light and history, both (N, C, H, W). readable (N, 1, H, W): 1 where history may be read, else 0.

        prior: (N, C, H, W), which is not filtered.
        """
        own = [light] if prior is None else [light, prior]
        pyramid = [light]
        for _ in kernels[1:]:
            pyramid.append(F.avg_pool2d(pyramid[-1], 2))
        pairs = zip(pyramid, (scale.spatial for scale in kernels), strict=True)
        scales = [average(image, spatial) for image, spatial in pairs if spatial is not None]
        if history is None or readable is None:
            return Filtered(scales, own, None, None)
        if kernels[0].mixing is not None:
            return Filtered(scales, own, history, readable > 0)
        temporal = kernels[0].temporal
        past = (None, None) if temporal is None else apply_masked(history, readable, temporal)
        return Filtered(scales, own, *past)


class Blending(nn.Module):
    """The step that combines the scales (Eq. 4), and blends the result with the filtered history (Eq. 1).

    most: upper limit of the light, such as 1 for a share; None for none. Costs a bilinear upsampling per scale and
    some operations per component.
    """

    def __init__(self, downsample: Downsample, most: float | None) -> None:
        super().__init__()
        self.downsample: Downsample = downsample
        self.most = most

    def forward(self, filtered: Filtered, kernels: list[ScaleKernels]) -> tuple[Tensor, Tensor | None]:
        """Return the light (N, C, H, W) in [0, most], and α (N, 1, H, W) of the last blend if there is a history."""
        output = combined(filtered.scales, kernels, self.downsample)
        # Before blending, compression and storage, since Eq. 4 may go below 0, and above the largest input.
        output = output.clamp(min=0, max=self.most)
        alpha, history, known = kernels[0].alpha, filtered.history, filtered.known
        if alpha is None or history is None or known is None:
            return output, None
        alpha = torch.where(known, alpha, 1.0)
        return alpha * output + (1 - alpha) * history, alpha  # Eq. 1


class Mixing(nn.Module):
    """The step that makes the image of one of half its resolution, the noisy pixel, its history, and a prior if any.

    Each pixel has TAPS weights: for 3×3 pixels of the combined scales of half the resolution and below, for its own
    light, and for its history; and one more for a prior. So the result lies between values that are there, at a third
    of the time that kernels at full resolution take. Costs TAPS·C multiply-adds per pixel.
    """

    def __init__(self, downsample: Downsample, most: float | None) -> None:
        super().__init__()
        self.downsample: Downsample = downsample
        self.most = most

    def forward(self, filtered: Filtered, kernels: list[ScaleKernels]) -> tuple[Tensor, Tensor | None]:
        """Return the light (N, C, H, W) in [0, most], and the share of what is not history, (N, 1, H, W)."""
        mixing, own = kernels[0].mixing, filtered.own
        assert mixing is not None
        half = combined(filtered.scales, kernels, self.downsample).clamp(min=0, max=self.most)
        height, width = half.shape[-2:]
        # A traced graph keeps shape[0] free, but len() fixed.
        taps = mixing.view(mixing.shape[0], -1, 1, 4, height, width)[:, :_AROUND]
        padded = F.pad(half, [1] * 4, mode="replicate")[:, :, None]
        around = taps[:, 0] * padded[..., :height, :width]
        for tap in range(1, _AROUND):
            y, x = divmod(tap, 3)
            around = around + taps[:, tap] * padded[..., y : y + height, x : x + width]
        # At full resolution at once: gathering 2×2 pixels of each image instead takes ONNX Runtime twice as long.
        parts = [around.flatten(1, 2), taps.sum(1).flatten(1, 2), mixing[:, 4 * _AROUND :]]
        shuffled = _unblocked(torch.cat(parts, 1))
        components = half.shape[1]
        mixed, total, weights = torch.split(shuffled, [components, 1, shuffled.shape[1] - components - 1], 1)
        for tap, image in enumerate(own):
            weight = weights[:, tap : tap + 1]
            mixed, total = mixed + weight * image, total + weight
        if filtered.history is None or filtered.known is None:
            return mixed / total, None
        of_history = weights[:, -1:] * filtered.known.to(half.dtype)
        whole = total + of_history
        return (mixed + of_history * filtered.history) / whole, total / whole


def _unblocked(blocks: Tensor) -> Tensor:
    """Put 2×2 pixels back: (N, 4·C, H, W) → (N, C, 2·H, 2·W)."""
    if not is_tracing():
        return F.pixel_shuffle(blocks, 2)
    # A convolution with a single one for each pixel is exact, and takes ONNX Runtime a fifth of its DepthToSpace.
    components = int(blocks.shape[1]) // 4  # a constant of the graph
    places = torch.eye(4, dtype=blocks.dtype).view(4, 1, 2, 2).repeat(components, 1, 1, 1)
    return F.conv_transpose2d(blocks, places, stride=2, groups=components)


def combined(scales: list[Tensor], kernels: list[ScaleKernels], downsample: Downsample) -> Tensor:
    """Combine scales, finest first, from coarse to fine by Eq. 4; the last of `kernels` belongs to the last of them."""
    output = scales[-1]
    for fine, coarse in zip(reversed(scales[:-1]), reversed(kernels), strict=False):
        assert coarse.alpha is not None
        output = combine_scales(fine, output, coarse.alpha, downsample)
    return output


def apply_masked(image: Tensor, weight: Tensor, kernels: Tensor) -> tuple[Tensor, Tensor]:
    """Apply kernels to the pixels whose weight (N, 1, H, W) is 1 rather than 0, and renormalise the kernels.

    Returns the image (N, C, H, W), and (N, 1, H, W) bool, true where a kernel had anything to read; elsewhere the image
    is 0.
    """
    summed = apply_kernels(torch.cat([image * weight, weight], 1), kernels)
    total = summed[:, -1:]
    known = total > LEAST_WEIGHT
    return summed[:, :-1] / torch.where(known, total, 1.0) * known, known


def padded(images: Tensor, multiple: int) -> Tensor:
    """Pad images (N, C, H, W) at the bottom and on the right to multiples of a size; the border repeats."""
    height, width = images.shape[-2:]
    return F.pad(images, (0, -width % multiple, 0, -height % multiple), mode="replicate")
