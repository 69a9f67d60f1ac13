"""Fetching the previous frame with a Catmull–Rom spline, which stays sharper over many frames than bilinear."""

import torch
from torch import Tensor

from nte.motion.warp import Warped, fetch_nearest, inside, pixel_centres


def warp_catmull_rom(image: Tensor, motion: Tensor) -> Warped:
    """Fetch image(x + motion(x)) with 4×4 pixels, for motion (N, 2, H, W) in pixels, current → previous.

    image (N, C, H, W). The result may leave the image's range, since the spline has negative lobes. Outside the image
    the border repeats and `valid` is false; `valid` is also false where the motion is not finite. A motion of whole
    pixels returns the pixel unchanged. Catmull and Rom 1974; used for history by Yang et al. 2020, «A Survey of
    Temporal Antialiasing».
    """
    height, width = image.shape[-2:]
    position = pixel_centres(image) + motion
    valid = inside(position)
    limit = position.new_tensor([width, height]).view(1, 2, 1, 1)
    position = position.nan_to_num().clamp(min=0).minimum(limit)
    base = (position - 0.5).floor() + 0.5  # centre of the nearest pixel up and to the left
    part = position - base
    across, down = _weights(part[:, :1]), _weights(part[:, 1:])
    total = torch.zeros_like(image)
    for j, weight_y in enumerate(down):
        for i, weight_x in enumerate(across):
            step = position.new_tensor([i - 1, j - 1]).view(1, 2, 1, 1)
            total += fetch_nearest(image, base + step) * (weight_x * weight_y)
    return Warped(total, valid)


def _weights(t: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """The weights, with sum 1, of the four pixels around a position t ∈ [0, 1] px beyond the second."""
    t2, t3 = t * t, t * t * t
    return (-t3 + 2 * t2 - t) / 2, (3 * t3 - 5 * t2 + 2) / 2, (-3 * t3 + 4 * t2 + t) / 2, (t3 - t2) / 2
