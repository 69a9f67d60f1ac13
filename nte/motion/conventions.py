"""Other people's motion vectors: the ways in which they differ from ours, and back.

Ours: pixels, x to the right, y down, current → previous, on the pixels of the current frame.
"""

from dataclasses import dataclass
from itertools import product

from torch import Tensor

from nte.motion.geometric import scatter_forward_motion

UNITS = {"pixels": 1.0, "uv, [0, 1] over the image": 1.0, "NDC, [−1, 1] over the image": 0.5}


@dataclass(frozen=True)
class Convention:
    """How given vectors are to be read: what differs from ours, in words, and how to convert them."""

    signs: tuple[int, int] = (1, 1)
    swapped: bool = False
    unit: str = "pixels"
    forward: bool = False

    def __str__(self) -> str:
        """What differs, as a user would say it."""
        differs = []
        if self.forward:
            differs.append("direction (they point from the previous frame to the current one)")
        if self.signs == (-1, -1):
            differs.append("sign (they point from previous to current)")
        elif self.signs != (1, 1):
            differs.append("sign of x" if self.signs[0] < 0 else "sign of y (y counts upwards)")
        if self.swapped:
            differs.append("axis order (y before x)")
        if self.unit != "pixels":
            differs.append(f"unit ({self.unit})")
        return ", ".join(differs) or "ours"

    def convert(self, motion: Tensor, previous_motion: Tensor, previous_depth: Tensor) -> Tensor:
        """Our vectors (N, 2, H, W) from those of the current and the previous frame; NaN where unknown.

        previous_depth (N, 1, H, W), 0 = miss: which of several surfaces that arrive at a pixel is seen there.
        """
        if self.forward:
            # Stored on the previous frame's pixels: scattered to where they point.
            return scatter_forward_motion(previous_motion, previous_depth)
        height, width = motion.shape[-2:]
        scale = (1.0, 1.0) if self.unit == "pixels" else (width * UNITS[self.unit], height * UNITS[self.unit])
        factors = [sign * size for sign, size in zip(self.signs, scale, strict=True)]
        ours = motion.flip(1) if self.swapped else motion
        return ours * motion.new_tensor(factors).view(1, 2, 1, 1)


CONVENTIONS = (
    *(
        Convention(signs, swapped, unit)
        for unit, swapped, signs in product(UNITS, (False, True), ((1, 1), (1, -1), (-1, 1), (-1, -1)))
    ),
    Convention(forward=True),
)
