"""The reprojection of what a network carries from frame to frame, and statistics over time.

Zeng et al., «Neural Temporal Denoising for Indirect Illumination», Eqs. 2 and 3.
"""

from typing import NamedTuple

import torch
from torch import Tensor, nn

from nte.color import per_sequence
from nte.frames.usable import usable_depth, usable_vector, within
from nte.motion.geometric import dual_motion, traditional_motion
from nte.motion.warp import warp
from nte.recurrence import FORWARD, Recurrent

LONGEST = 32.0  # frames; a longer history counts as this long, so that moments follow a scene that changes


class Reprojected(NamedTuple):
    """What was carried, on the pixels of this frame, and where it can be trusted: masks (N, 1, H, W), bool."""

    carried: Tensor | None  # (N, C, H, W); of any value where it is not valid
    valid: Tensor  # its source lies in the previous image, and is finite; false where a sequence starts
    disoccluded: Tensor  # the surface was hidden in the previous frame; false where a sequence starts
    continues: Tensor  # (N, 1, 1, 1) bool: false where a sequence starts


class Reprojection(nn.Module):
    """The step that fetches carried images along traditional or dual motion vectors.

    vectors: channels that it uses if there, besides motion. recurrent: what it carries for itself, as a network
    declares it. Costs one bilinear fetch (4 products per component), and for dual vectors two fetches of the nearest
    pixel.
    """

    def __init__(self, dual: bool) -> None:
        super().__init__()
        self.dual = dual
        self.vectors: tuple[str, ...] = (FORWARD,) if dual else ()
        self.recurrent = {"previous_depth": Recurrent("depth", 1)} if dual else {}

    def forward(
        self, motion: Tensor, forward_motion: Tensor | None, depth: Tensor, previous_depth: Tensor | None,
        reset: Tensor, carried: Tensor | None,
    ) -> Reprojected:  # fmt: skip
        """Reproject carried images (N, C, H, W).

        motion (N, 2, H, W): px, current → previous. forward_motion (N, 2, H, W): px, on the previous frame, to the
        current one; depth: usable; previous_depth: as it was given. The last two and forward_motion are for dual
        vectors. reset (N,): 1 where a sequence starts.
        """
        motion = usable_vector(motion)
        if self.dual and forward_motion is not None and previous_depth is not None:
            forward = usable_vector(forward_motion)
            vectors = dual_motion(motion, forward, depth, usable_depth(previous_depth))
        else:
            vectors = traditional_motion(motion)
        continues = per_sequence(reset) == 0
        valid, disoccluded = vectors.valid & continues, vectors.disoccluded & continues
        if carried is not None:
            carried = warp(carried, vectors.motion).image
            valid = valid & within(carried)
        return Reprojected(carried, valid, disoccluded, continues)


class Statistics(NamedTuple):
    """Statistics of one value per pixel over the frames in which its surface was seen."""

    moments: Tensor  # (N, 2, H, W): the means of the value and of its square
    length: Tensor  # (N, 1, H, W): number of these frames, 1 to LONGEST

    def deviation(self) -> Tensor:
        """Return the standard deviation (N, 1, H, W); 0 for a single frame."""
        return (self.moments[:, 1:] - self.moments[:, :1].square()).clamp(min=0).sqrt()

    def features(self) -> Tensor:
        """Return mean, standard deviation and 1/length, (N, 3, H, W): of a scale of about 1 if the value is."""
        return torch.cat([self.moments[:, :1], self.deviation(), self.length.reciprocal()], 1)


def accumulate(value: Tensor, moments: Tensor, length: Tensor, valid: Tensor) -> Statistics:
    """Add a value (N, 1, H, W) to reprojected statistics; where they are not valid (bool) it starts new ones.

    The frames have equal weights until there are LONGEST of them; then the oldest fade (Schied et al. 2017, «SVGF»,
    section 4.1, with another floor).
    """
    length = torch.where(valid, (length + 1).clamp(1, LONGEST), 1.0)
    now = torch.cat([value, value.square()], 1)
    past = torch.where(valid, moments, now)
    return Statistics(past + (now - past) / length, length)
