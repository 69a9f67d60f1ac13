"""Noise without a state: a function of pixel, frame and dimension, the same on every device and in every batch."""

import math

import torch
from torch import Tensor

_MASK = 0xFFFFFFFF


def gaussian_noise(height: int, width: int, frame: int, device: torch.device) -> Tensor:
    """(1, 2, H, W): independent standard normal numbers, two for each pixel of the frame (Box and Muller 1958)."""
    pixel = torch.arange(height * width, device=device).view(1, height, width)
    dimension = torch.arange(2, device=device).view(2, 1, 1)
    bits = _hash(pixel + _hash(2 * frame + dimension))
    # Never 0: the logarithm must be finite.
    uniform = ((bits >> 8).float() + 0.5) / 2**24
    radius, angle = (-2 * uniform[0].log()).sqrt(), 2 * math.pi * uniform[1]
    return torch.stack([radius * angle.cos(), radius * angle.sin()])[None]


def _hash(value: Tensor) -> Tensor:
    """32 well mixed bits of each number: the finalizer of MurmurHash3 (Appleby), in 64-bit integers."""
    value = value & _MASK
    value = ((value ^ (value >> 16)) * 0x85EBCA6B) & _MASK
    value = ((value ^ (value >> 13)) * 0xC2B2AE35) & _MASK
    return value ^ (value >> 16)
