"""Conventions of motion vectors in other software, and their conversion to ours.

Our vectors are in pixels, x to the right, y down, current → previous, on the pixels of the current frame.
"""

from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # the base install, without PyTorch, reads other renderers' frames
    from torch import Tensor

UNITS = {"pixels": 1.0, "uv, [0, 1] over the image": 1.0, "NDC, [−1, 1] over the image": 0.5}


@dataclass(frozen=True)
class Convention:
    """A convention of motion vectors: how it differs from ours, in words, and how its vectors are converted.

    forward: vectors that lie on the pixels of the previous frame; with signs (1, 1) they point to the current one.
    """

    signs: tuple[int, int] = (1, 1)
    swapped: bool = False
    unit: str = "pixels"
    forward: bool = False

    def __str__(self) -> str:
        """Describe in words how the convention differs from ours; "ours" if it does not."""
        differs = []
        if self.forward:
            differs.append("direction (they are stored on the previous frame's pixels and point to the current one)")
        if self.signs == (-1, -1):
            where = "" if self.forward else ", on the current frame's pixels"
            differs.append(f"sign (they are negated{where})")
        elif self.signs != (1, 1):
            differs.append("sign of x" if self.signs[0] < 0 else "sign of y (y counts upwards)")
        if self.swapped:
            differs.append("axis order (y before x)")
        if self.unit != "pixels":
            differs.append(f"unit ({self.unit})")
        return ", ".join(differs) or "ours"

    def convert(self, motion: "Tensor", previous_motion: "Tensor", previous_depth: "Tensor") -> "Tensor":
        """Convert vectors of this convention to ours, (N, 2, H, W); NaN where the motion is unknown.

        motion and previous_motion: the given vectors of the current and of the previous frame. previous_depth
        (N, 1, H, W), 0 = miss: used for forward vectors, where it decides which of several surfaces that arrive at a
        pixel is seen.
        """
        if self.forward:
            # Forward vectors lie on the previous frame's pixels, so they are scattered to where they point.
            from nte.motion.geometric import scatter_forward_motion

            return scatter_forward_motion(self._in_pixels(previous_motion), previous_depth)
        return self._in_pixels(motion)

    def factors(self, height: int, width: int) -> list[float]:
        """What x and y, in this order, are multiplied by to be pixels to the right and down, for an image's size."""
        scale = (1.0, 1.0) if self.unit == "pixels" else (width * UNITS[self.unit], height * UNITS[self.unit])
        return [sign * size for sign, size in zip(self.signs, scale, strict=True)]

    def _in_pixels(self, motion: "Tensor") -> "Tensor":
        """The vectors (N, 2, H, W) on their own pixels, in pixels, x to the right first, y down."""
        ours = motion.flip(1) if self.swapped else motion
        return ours * motion.new_tensor(self.factors(*motion.shape[-2:])).view(1, 2, 1, 1)


CONVENTIONS = tuple(
    Convention(signs, swapped, unit, forward)
    for forward, unit, swapped, signs in product(
        (False, True), UNITS, (False, True), ((1, 1), (1, -1), (-1, 1), (-1, -1))
    )
)
