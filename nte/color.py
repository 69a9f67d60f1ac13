"""Light and colour on tensors: luminance, compression, display and demodulation.

Radiance is linear and scene-referred, in [0, inf); every image is (N, C, H, W).
"""

import torch
from torch import Tensor

from nte.frames.srgb import DARK, GAIN, OFFSET, POWER, SLOPE

REC709 = (0.2126, 0.7152, 0.0722)
ALBEDO_FLOOR = 1e-2  # least divisor of demodulation: darker surfaces would amplify noise without bound
PSNR_MAX = 100.0  # dB, also that of identical images: below it lies the rounding of a display value
BLACK = 1e-3  # an albedo below in all components tells nothing: a metal elsewhere, an emitter, the sky, a bad pixel


def luminance(rgb: Tensor) -> Tensor:
    """Rec. 709 luminance (N, 1, H, W) of linear rgb (N, 3, H, W)."""
    weights = rgb.new_tensor(REC709).view(1, 3, 1, 1)
    return (rgb * weights).sum(1, keepdim=True)


def compress(radiance: Tensor) -> Tensor:
    """log(1 + x) of exposed radiance in [0, inf): what networks see and losses compare."""
    return torch.log1p(radiance)


def display(radiance: Tensor, exposure: Tensor) -> Tensor:
    """Display transform to [0, 1]: exposure (N,), x/(1+x), then the sRGB curve."""
    exposed = radiance.clamp(min=0) * per_sequence(exposure)
    tonemapped = exposed / (1 + exposed)
    curve = GAIN * tonemapped.clamp(min=DARK) ** (1 / POWER) - OFFSET
    return torch.where(tonemapped <= DARK, SLOPE * tonemapped, curve)


def psnr(squared_error: Tensor) -> Tensor:
    """Peak signal-to-noise ratio in dB, at most PSNR_MAX, of a mean squared error of images in [0, 1]."""
    return (-10 * squared_error.log10()).clamp(max=PSNR_MAX)


def demodulate(radiance: Tensor, albedo: Tensor, floor: float = ALBEDO_FLOOR) -> Tensor:
    """Radiance over albedo: the light without the texture. Undone exactly by `remodulate` with the same floor."""
    return radiance / divisor(albedo, floor)


def remodulate(irradiance: Tensor, albedo: Tensor, floor: float = ALBEDO_FLOOR) -> Tensor:
    """Light times texture: the inverse of `demodulate`."""
    return irradiance * divisor(albedo, floor)


def divisor(albedo: Tensor, floor: float = ALBEDO_FLOOR) -> Tensor:
    """What light is divided by (N, 3, H, W): the albedo, at least `floor`; towards 1 where it is black.

    An albedo of 0 in all components does not say how much light arrives: divided by the floor, what a metal reflects
    would become a firefly that history keeps. Between BLACK and 0 the divisor goes from the floor to 1.
    """
    known = (albedo.amax(1, keepdim=True) / BLACK).clamp(max=1)
    return torch.lerp(torch.ones_like(albedo), albedo.clamp(min=floor), known)


def per_sequence(scalar: Tensor) -> Tensor:
    """(N,) → (N, 1, 1, 1), to scale images of a batch one by one."""
    return scalar.view(-1, 1, 1, 1)
