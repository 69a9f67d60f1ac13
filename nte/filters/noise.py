"""Random numbers without a state: functions of pixel, frame and dimension, equal on every device and in every batch."""

import math

import torch
from torch import Tensor

_MASK = 0xFFFFFFFF


def gaussian_noise(height: int, width: int, frame: int, device: torch.device, key: int | Tensor = 0) -> Tensor:
    """Draw independent standard normal numbers (1, 2, H, W), two for each pixel of the frame (Box and Muller 1958).

    key: of the sequence, or of each pixel (H, W), int64; another key gives other numbers.
    """
    uniform = uniform_noise(height, width, frame, 2, device, key)
    radius, angle = (-2 * uniform[:, :1].log()).sqrt(), 2 * math.pi * uniform[:, 1:]
    return torch.cat([radius * angle.cos(), radius * angle.sin()], 1)


def uniform_noise(
    height: int, width: int, frame: int, dimensions: int, device: torch.device, key: int | Tensor = 0
) -> Tensor:
    """Draw independent numbers (1, D, H, W), uniform in (0, 1), D = `dimensions` for each pixel of the frame.

    key: of the sequence, or of each pixel (H, W), int64; another key gives other numbers.
    """
    pixel = torch.arange(height * width, device=device).view(1, height, width)
    dimension = torch.arange(dimensions, device=device).view(dimensions, 1, 1)
    bits = _hash(pixel + (_hash(dimensions * frame + dimension) ^ _hash(torch.as_tensor(key, device=device))))
    # Never 0, so that the logarithm is finite.
    return (((bits >> 8).float() + 0.5) / 2**24)[None]


def _hash(value: Tensor) -> Tensor:
    """32 well-mixed bits of each number: the finalizer of MurmurHash3 (Appleby), in 64-bit integers."""
    value = value & _MASK
    value = ((value ^ (value >> 16)) * 0x85EBCA6B) & _MASK
    value = ((value ^ (value >> 13)) * 0xC2B2AE35) & _MASK
    return value ^ (value >> 16)
