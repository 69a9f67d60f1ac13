"""The inputs of a frame that all three effects share."""

from typing import NamedTuple

import torch.nn.functional as F
from torch import Tensor

from nte.filters.bilateral import Edges, Guide, make_edges, make_guide
from nte.filters.scope import scope
from nte.frames.frame import Frame
from nte.motion.geometric import Reprojection, complete_forward_motion, dual_motion, traditional_motion
from nte.motion.warp import fetch_nearest, pixel_centres

RADIUS = 15  # px, of the widest separable filter, 31×31
APART = 0.05  # px; a disocclusion's half pixel would let what moves slowly leave a trace on what it uncovers


class GBuffer(NamedTuple):
    """The G-buffer of a frame."""

    normal: Tensor  # (N, 3, H, W) unit, 0 at a miss
    depth: Tensor  # (N, 1, H, W), 0 at a miss
    roughness: Tensor  # (N, 1, H, W)
    position: Tensor | None = None  # (N, 3, H, W) world, 0 at a miss; None if the frame does not have it
    geometric: Tensor | None = None  # (N, 3, H, W) unit, without normal maps; None if the frame does not have it


class FrameInputs(NamedTuple):
    """The inputs that every effect gets for a frame."""

    frame: Frame  # PyTorch, sanitised
    gbuffer: GBuffer
    before: GBuffer | None  # of the previous frame
    guide: Guide
    edges: Edges
    traditional: Reprojection  # the traditional vectors, with the disocclusions that the dual ones have found
    dual: Reprojection
    apart: Tensor  # (N, 1, H, W) bool: what was at the traditional vectors' ends is not there now


def prepare(frame: Frame, before: GBuffer | None) -> FrameInputs:
    """Compute the inputs that the effects share from a sanitised PyTorch frame and the previous frame's G-buffer."""
    with scope("trmv/guide"):
        gbuffer = GBuffer(
            F.normalize(frame["normal"], dim=1),
            # Copies, since a caller may fill its buffers again before the next frame reads this G-buffer.
            frame["depth"].clone(),
            frame["roughness"].clone(),
            *(frame[name].clone() if name in frame else None for name in ("position", "geometric_normal")),
        )
        guide = make_guide(gbuffer.normal, gbuffer.depth, frame["roughness"])
        edges = make_edges(guide, RADIUS)
    with scope("trmv/vectors"):
        forward = complete_forward_motion(frame.get("previous_forward_motion"), frame["motion"], frame["depth"])
        dual = dual_motion(frame["motion"], forward, frame["depth"], None if before is None else before.depth)
        traditional = traditional_motion(frame["motion"])._replace(disoccluded=dual.disoccluded)
        back = fetch_nearest(forward, pixel_centres(forward) + traditional.motion) + traditional.motion
        apart = back.square().sum(1, keepdim=True) > APART**2  # false for NaN
    return FrameInputs(frame, gbuffer, before, guide, edges, traditional, dual, apart)
