"""Pictures of a frame's channels, reduced in size, and the strength of their edges, to compare light with guides."""

import torch
import torch.nn.functional as F
from torch import Tensor

from nte.frames.channels import CHANNELS
from nte.frames.frame import Frame

AROUND = 15  # pixels: edges are compared with the mean of those around, since whole regions have more or fewer of them
SCATTER = 0.618034, 0.754878, 0.569840  # ids times these have fractions that are scattered over [0, 1]
BRIGHTEST, NEAREST = 0.95, 10.0  # share of the edges that keep their strength; median depth over that of what is near


def picture(frame: Frame, name: str, size: tuple[int, int]) -> Tensor:
    """Reduce a channel of a PyTorch frame of batch 1 to means over blocks: (1, C, h, w) of `size` (h, w).

    Radiance becomes the logarithm of its brightness, depth its inverse, and each id a colour. Bad pixels count as 0.
    """
    if CHANNELS[name].kind == "radiance":
        return F.adaptive_avg_pool2d(_brightness(frame[name]), size).log1p()
    values = frame[name].nan_to_num(0, 0, 0)
    if CHANNELS[name].kind == "depth":
        values = _nearness(frame[name])
    elif CHANNELS[name].kind == "id":
        values = (values.double() * values.new_tensor(SCATTER).view(1, 3, 1, 1)).frac().float()
    return F.adaptive_avg_pool2d(values, size)


def _brightness(image: Tensor) -> Tensor:
    """Convert radiance (1, 3, H, W) to grey (1, 1, H, W), in units of a twentieth of its mean; bad pixels become 0."""
    usable = torch.where(image.isfinite() & (image >= 0), image, 0.0).mean(1, keepdim=True)
    return usable / (0.05 * usable.mean()).clamp(min=1e-30)


def _nearness(depth: Tensor) -> Tensor:
    """Compute inverse depth (1, 1, H, W) in units of its median; 0 for the sky."""
    hit = (depth > 0) & depth.isfinite()
    if not hit.any():
        return torch.zeros_like(depth)
    return torch.where(hit, depth[hit].median() / depth.clamp(min=1e-30), 0.0).clamp(max=NEAREST)


def edges(image: Tensor) -> Tensor:
    """Measure the strength (h, w) of the edges of an image (1, C, h, w), above the mean of those around."""
    padded = F.pad(image, (1, 1, 1, 1), mode="replicate")
    across = padded[..., 1:-1, 2:] - padded[..., 1:-1, :-2]
    down = padded[..., 2:, 1:-1] - padded[..., :-2, 1:-1]
    strength = (across.square() + down.square()).sum(1, keepdim=True).sqrt()
    strength = strength.clamp(max=float(strength.flatten().quantile(BRIGHTEST)))
    side = min(AROUND, 2 * ((min(image.shape[2:]) - 1) // 2) - 1)
    around = F.avg_pool2d(strength, side, 1, side // 2, count_include_pad=False)
    return (strength - around)[0, 0]
