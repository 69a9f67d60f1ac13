"""Flips, colour permutations, brightness and rotations that keep every channel consistent with the others.

A mirrored image shows a mirrored world. The table of channels says how each channel changes: image vectors follow the
image's axes, and world vectors are mirrored with the world, once for every mirroring of the image. Which of the
world's axes is mirrored is free, as a scene has no preferred rotation; here it is x. World vectors can be rotated
besides: cameras look in all directions, and motion in the image does not tell which.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from nte.frames.channels import CHANNELS


@dataclass(frozen=True)
class Augmentation:
    """One of the 8 symmetries of the image (transpose, then flips), one of the 6 orders of R, G, B, and more.

    light: factor of all radiance; the sequence's exposure is divided by it, as if it were measured again. exposed:
    factor of the exposure alone, of a sequence that is brighter or darker than it assumes. rotation (3, 3): of the
    world, after it was mirrored; None: none.
    """

    transpose: bool = False
    flip_x: bool = False
    flip_y: bool = False
    colours: tuple[int, int, int] = (0, 1, 2)
    light: float = 1.0
    exposed: float = 1.0
    rotation: Tensor | None = None

    @classmethod
    def draw(cls, rng: np.random.Generator) -> "Augmentation":
        """Draw a random augmentation, all equally likely."""
        transpose, flip_x, flip_y = (bool(bit) for bit in rng.integers(2, size=3))
        red, green, blue = (int(c) for c in rng.permutation(3))
        return cls(transpose, flip_x, flip_y, (red, green, blue))

    def lit(self, rng: np.random.Generator, light: float, exposed: float) -> "Augmentation":
        """Draw the factors of radiance and of exposure, log-uniformly within ± so many stops; nothing for 0 stops."""
        factors = [2.0 ** float(rng.uniform(-stops, stops)) if stops else 1.0 for stops in (light, exposed)]
        return replace(self, light=factors[0], exposed=factors[1])

    def turned(self, rng: np.random.Generator) -> "Augmentation":
        """Draw a rotation of the world, all equally likely (Mezzadri 2007, «How to Generate Random Matrices»)."""
        q, r = np.linalg.qr(rng.normal(size=(3, 3)))
        q = q * np.sign(np.diag(r))
        q[:, 0] *= np.linalg.det(q)  # a rotation, as mirroring belongs to the image's symmetry
        return replace(self, rotation=torch.from_numpy(q.astype(np.float32)))

    def scalars(self, scalars: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Apply the augmentation to a sequence's scalars (N,) by name: the exposure changes."""
        return {**scalars, "exposure": scalars["exposure"] * (self.exposed / self.light)}

    def __call__(self, channels: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Apply the augmentation to channels (..., C, H, W) by name; a transpose swaps H and W."""
        return {name: self._channel(name, values) for name, values in channels.items()}

    def _channel(self, name: str, values: Tensor) -> Tensor:
        values = self._values(CHANNELS[name].augment, values)
        if self.light != 1 and CHANNELS[name].unit in ("radiance", "luminance"):
            values = values * self.light
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
        if augment == "world" and self.rotation is not None:
            values = torch.einsum("ij,...jhw->...ihw", self.rotation.to(values), values)
        return values
