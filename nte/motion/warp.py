"""Reprojection: fetching the previous frame along motion vectors, with a validity mask.

Positions are in pixels with centres at +0.5, x to the right, y down. previous = current + motion.
"""

from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor

from nte.errors import NteError


class Warped(NamedTuple):
    """A fetched image (N, C, H, W), and where its source lies inside the previous image: (N, 1, H, W), bool."""

    image: Tensor
    valid: Tensor


def pixel_centres(like: Tensor) -> Tensor:
    """Return x and y of every pixel's centre, (1, 2, H, W), for the size and device of an image (…, H, W)."""
    height, width = like.shape[-2:]
    y = torch.arange(height, device=like.device, dtype=torch.float32) + 0.5
    x = torch.arange(width, device=like.device, dtype=torch.float32) + 0.5
    return torch.stack([x.view(1, -1).expand(height, width), y.view(-1, 1).expand(height, width)]).unsqueeze(0)


def inside(position: Tensor) -> Tensor:
    """Return (N, 1, H, W), true where a position (N, 2, H, W) lies in an image of the same size; NaN is outside."""
    height, width = position.shape[-2:]
    x, y = position[:, :1], position[:, 1:]
    return (x >= 0) & (x <= width) & (y >= 0) & (y <= height)


def warp(image: Tensor, motion: Tensor) -> Warped:
    """Fetch image(x + motion(x)) bilinearly, for motion (N, 2, H, W) in pixels, current → previous.

    image (N, C, H, W). Outside the image the border repeats and `valid` is false; `valid` is also false where the
    motion is not finite. Costs one grid_sample; differentiable in the image.

    >>> previous = torch.arange(4.0).view(1, 1, 1, 4)
    >>> motion = torch.tensor([1.0, 0.0]).view(1, 2, 1, 1).expand(1, 2, 1, 4)  # everything was one pixel to the right
    >>> found = nte.warp(previous, motion)
    >>> found.image.flatten().tolist()
    [1.0, 2.0, 3.0, 3.0]
    >>> found.valid.flatten().tolist()
    [True, True, True, False]
    """
    position = pixel_centres(image) + motion
    return Warped(fetch_bilinear(image, position), inside(position))


def fetch_along(image: Tensor, motion: Tensor) -> Tensor:
    """Fetch image(x + motion(x)) as `warp` does, but without the validity mask, which would double the cost."""
    return fetch_bilinear(image, pixel_centres(image) + motion)


def fetch_bilinear(image: Tensor, position: Tensor) -> Tensor:
    """Fetch an image (N, C, H, W) at positions (N, 2, h, w), px, giving (N, C, h, w); outside, the border repeats."""
    height, width = image.shape[-2:]
    # A position far outside, or NaN, would overflow the integer pixel index.
    x = position[:, 0].nan_to_num().clamp(0, width) / width
    y = position[:, 1].nan_to_num().clamp(0, height) / height
    grid = torch.stack([x, y], 3).mul_(2).sub_(1)
    return F.grid_sample(image, grid, mode="bilinear", padding_mode="border", align_corners=False)


def fetch_nearest(image: Tensor, position: Tensor) -> Tensor:
    """Fetch the pixels of an image (N, C, H, W) that contain positions (N, 2, H, W); outside, the nearest border pixel.

    For values that must not be interpolated: motions, depths, ids. Positions must be finite.
    """
    flat = nearest_index(position).expand(-1, image.shape[1], -1)
    return image.flatten(2).gather(2, flat).view(position.shape[0], image.shape[1], *position.shape[-2:])


def nearest_index(position: Tensor) -> Tensor:
    """Return the row-major index (N, 1, H·W), int64, of the pixel that contains each position, clamped to the image."""
    height, width = position.shape[-2:]
    x = position[:, 0].floor().clamp(0, width - 1)
    y = position[:, 1].floor().clamp(0, height - 1)
    return (y.long() * width + x.long()).flatten(1).unsqueeze(1)


def refuse_other_shape(name: str, image: Tensor | None, like_name: str, like: Tensor) -> None:
    """Raise NteError if an image (N, ·, H, W), unless it is None, has another batch or size than `like`.

    What is fetched by position has no need to be as large, so PyTorch would not tell. name and like_name: for the
    error.
    """
    if image is not None and (image.shape[0], *image.shape[2:]) != (like.shape[0], *like.shape[2:]):
        raise NteError(
            f"{name} has the shape {tuple(image.shape)}, expected the batch and size of {like_name}, "
            f"{tuple(like.shape)}"
        )
