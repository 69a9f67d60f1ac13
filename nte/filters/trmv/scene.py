"""A frame made ready for all three effects."""

from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor
from torch.profiler import record_function

from nte.color import sanitise
from nte.filters.bilateral import Edges, Guide, make_edges, make_guide
from nte.frames.channels import CHANNELS
from nte.frames.frame import Frame
from nte.motion.geometric import Reprojection, frame_vectors, traditional_motion

RADIUS = 15  # of the widest separable filter, 31×31
_RANGES = {"radiance": (0.0, 1e30), "reflectance": (0.0, 1.0), "scalar": (0.0, 1.0), "depth": (0.0, 1e30)}


class Surface(NamedTuple):
    """The G-buffer of a frame."""

    normal: Tensor  # (N, 3, H, W) unit, 0 at a miss
    depth: Tensor  # (N, 1, H, W), 0 at a miss
    roughness: Tensor  # (N, 1, H, W)
    position: Tensor | None = None  # (N, 3, H, W) world, 0 at a miss; None: nobody asked for it
    geometric: Tensor | None = None  # (N, 3, H, W) unit, without normal maps; None: the frame does not say


class Scene(NamedTuple):
    """What every effect sees of a frame."""

    frame: Frame  # PyTorch, sanitised
    surface: Surface
    before: Surface | None  # of the previous frame
    guide: Guide
    edges: Edges
    traditional: Reprojection  # the traditional vectors, with the disocclusions that the dual ones have found
    dual: Reprojection


def prepare(frame: Frame, before: Surface | None) -> Scene:
    """Sanitise a PyTorch frame, and compute what the effects share."""
    with record_function("trmv/guide"):
        frame = sane(frame)
        surface = Surface(
            F.normalize(frame["normal"], dim=1), frame["depth"], frame["roughness"],
            frame.get("position"), frame.get("geometric_normal"),
        )  # fmt: skip
        guide = make_guide(surface.normal, surface.depth, frame["roughness"])
        edges = make_edges(guide, RADIUS)
    with record_function("trmv/vectors"):
        dual = frame_vectors(frame, None if before is None else before.depth)
        traditional = traditional_motion(frame["motion"])._replace(disoccluded=dual.disoccluded)
    return Scene(frame, surface, before, guide, edges, traditional, dual)


def sane(frame: Frame) -> Frame:
    """The frame without numbers that spread: light, reflectance and the like in their ranges, geometry finite.

    Vectors keep their NaNs, which say something.
    """

    def clean(name: str, values: Tensor) -> Tensor:
        kind = CHANNELS[name].kind
        if kind in _RANGES:
            return sanitise(values, *_RANGES[kind])
        if kind in ("direction", "point"):
            return torch.nan_to_num(values, 0, 0, 0)
        return values

    ours = {name: values for name, values in frame.channels.items() if name in CHANNELS}
    return frame.with_channels(**{name: clean(name, values) for name, values in ours.items()})
