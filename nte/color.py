"""Light and colour on tensors: luminance, compression, display transform and demodulation.

Radiance is linear and scene-referred, in [0, ∞). Every image is a tensor (N, C, H, W).
"""

import torch
from torch import Tensor

from nte.frames.srgb import DARK, GAIN, OFFSET, POWER, SLOPE

REC709 = (0.2126, 0.7152, 0.0722)
ALBEDO_FLOOR = 1e-2  # least divisor of demodulation: darker surfaces would amplify noise without bound
PSNR_MAX = 100.0  # dB, also for identical images: smaller errors are rounding of a display value
BLACK = 1e-3  # an albedo below this in all components says nothing: a foreign metal, an emitter, sky, a bad pixel


def luminance(rgb: Tensor) -> Tensor:
    """Compute the Rec. 709 luminance (N, 1, H, W) of linear RGB (N, 3, H, W)."""
    weights = rgb.new_tensor(REC709).view(1, 3, 1, 1)
    return (rgb * weights).sum(1, keepdim=True)


def compress(radiance: Tensor) -> Tensor:
    """Compute log(1 + x) of exposed radiance in [0, ∞): the scale in which networks see light and losses compare it."""
    return torch.log1p(radiance)


def display(radiance: Tensor, exposure: Tensor) -> Tensor:
    """Transform radiance (N, 3, H, W) to display values in [0, 1]: times exposure (N,), x / (1 + x), sRGB curve.

    Negative radiance counts as 0.
    """
    exposed = radiance.clamp(min=0) * per_sequence(exposure)
    tonemapped = exposed / (1 + exposed)
    curve = GAIN * tonemapped.clamp(min=DARK) ** (1 / POWER) - OFFSET
    return torch.where(tonemapped <= DARK, SLOPE * tonemapped, curve)


def undisplay(shown: Tensor) -> Tensor:
    """Convert display values (N, C, H, W) in [0, 1) to exposed radiance: the inverse of `display` at exposure 1.

    Values that are white to within rounding give a million.
    """
    curve = ((shown + OFFSET) / GAIN) ** POWER
    tonemapped = torch.where(shown <= SLOPE * DARK, shown / SLOPE, curve)
    return tonemapped / (1 - tonemapped).clamp(min=1e-6)


def psnr(squared_error: Tensor) -> Tensor:
    """Convert the mean squared error of images in [0, 1] to a peak signal-to-noise ratio in dB, at most PSNR_MAX."""
    return (-10 * squared_error.log10()).clamp(max=PSNR_MAX)


def demodulate(radiance: Tensor, albedo: Tensor, floor: float = ALBEDO_FLOOR) -> Tensor:
    """Divide radiance by albedo, both (N, 3, H, W), which leaves the light without the texture.

    The divisor is `divisor(albedo, floor)`. `remodulate` with the same floor is the exact inverse.
    """
    return radiance / divisor(albedo, floor)


def remodulate(irradiance: Tensor, albedo: Tensor, floor: float = ALBEDO_FLOOR) -> Tensor:
    """Multiply light by texture, both (N, 3, H, W): the inverse of `demodulate` with the same floor."""
    return irradiance * divisor(albedo, floor)


def divisor(albedo: Tensor, floor: float = ALBEDO_FLOOR) -> Tensor:
    """Compute the divisor of demodulation (N, 3, H, W): the albedo, at least `floor`, or up to 1 where it is black.

    An albedo of 0 in all components does not say how much light arrives: divided by the floor, the reflection in a
    metal would become a firefly that stays in the history. As the largest component falls from BLACK to 0, the divisor
    goes from the floor to 1.
    """
    known = (albedo.amax(1, keepdim=True) / BLACK).clamp(max=1)
    return torch.lerp(torch.ones_like(albedo), albedo.clamp(min=floor), known)


def per_sequence(scalar: Tensor) -> Tensor:
    """Reshape one scalar per sequence, (N,), to (N, 1, 1, 1), so that it scales each image of a batch."""
    return scalar.view(-1, 1, 1, 1)
