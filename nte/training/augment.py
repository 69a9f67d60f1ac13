"""Flips, transposes and colour permutations that keep every channel consistent with the others.

A mirrored image shows a mirrored world. The table of channels says how each channel changes: image vectors follow the
image's axes, and world vectors are mirrored with the world, once for every mirroring of the image. Which of the
world's axes is mirrored is free, as a scene has no preferred rotation; here it is x.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from nte.frames.channels import CHANNELS


@dataclass(frozen=True)
class Augmentation:
    """One of the 8 symmetries of the image (transpose, then flips) and one of the 6 orders of R, G, B."""

    transpose: bool = False
    flip_x: bool = False
    flip_y: bool = False
    colours: tuple[int, int, int] = (0, 1, 2)

    @classmethod
    def draw(cls, rng: np.random.Generator) -> "Augmentation":
        """Draw a random augmentation, all equally likely."""
        transpose, flip_x, flip_y = (bool(bit) for bit in rng.integers(2, size=3))
        red, green, blue = (int(c) for c in rng.permutation(3))
        return cls(transpose, flip_x, flip_y, (red, green, blue))

    def __call__(self, channels: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Apply the augmentation to channels (..., C, H, W) by name; a transpose swaps H and W."""
        return {name: self._channel(name, values) for name, values in channels.items()}

    def _channel(self, name: str, values: Tensor) -> Tensor:
        values = self._values(CHANNELS[name].augment, values)
        values = values.transpose(-1, -2) if self.transpose else values
        flipped = [axis for axis, flip in ((-1, self.flip_x), (-2, self.flip_y)) if flip]
        return values.flip(flipped) if flipped else values

    def _values(self, augment: str, values: Tensor) -> Tensor:
        components = list(range(values.shape[-3]))
        signs = [1.0] * len(components)
        if augment == "colour":
            components = list(self.colours)
        elif augment == "world" and (self.transpose + self.flip_x + self.flip_y) % 2:
            signs[0] = -1.0
        elif augment == "image":
            components = [1, 0] if self.transpose else [0, 1]
            signs = [-1.0 if self.flip_x else 1.0, -1.0 if self.flip_y else 1.0]
        elif augment == "covariance":  # XX, XY, YY
            components = [2, 1, 0] if self.transpose else [0, 1, 2]
            signs[1] = -1.0 if self.flip_x != self.flip_y else 1.0
        if components != list(range(len(components))):
            values = values[..., components, :, :]
        if any(sign < 0 for sign in signs):
            values = values * torch.tensor(signs, dtype=values.dtype, device=values.device).view(-1, 1, 1)
        return values
