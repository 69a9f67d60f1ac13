"""Conversion from a producer's conventions to nte's, one frame at a time."""

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from itertools import product

import numpy as np
import numpy.typing as npt

from nte.errors import needs_extra
from nte.frames.channels import VECTORS
from nte.frames.clip import Pixels
from nte.importing.cameras import Camera, camera_of_fov
from nte.importing.channel_map import DEPTHS, NORMALS, ChannelMap
from nte.importing.ids import UNNAMED
from nte.importing.source import SKY
from nte.motion.conventions import Convention

LEAST_NORMAL = 0.1  # each normal has a greater component; what is smaller is a rounded 0
_RINGS = 8  # px; unknown vectors this close to known ones are filled by depth


def to_ours(
    given: Mapping[str, Pixels], how: ChannelMap, camera: Camera | None = None, aspect: float = 1.0
) -> dict[str, Pixels]:
    """Convert decoded channels (C, H, W) from the conventions of the map `how` to nte's, under the same names.

    camera: needed for normals in camera space, and for depth along the ray if the map has no field of view; where it
    has one, aspect is the width of a pixel in units of its height. Misses get depth, normal, position and instance 0.
    Radiance is left as it is. Unknown vectors are NaN.
    """
    ours = {name: np.asarray(values, np.float32) for name, values in given.items()}
    if "albedo" in ours:
        ours["albedo"] = np.clip(ours["albedo"], 0, 1)
    rotation = camera.view[:3, :3].T if camera and how.normal.space == "camera" else np.eye(3)
    for name in (name for name in NORMALS if name in ours):
        normal = decoded(ours[name]) if how.normal.encoded else ours[name]
        ours[name] = unit(np.einsum("ij,jhw->ihw", rotation, normal)).astype(np.float32)
    for name in VECTORS:
        if name in ours:
            ours[name] = convert_vectors(ours[name], getattr(how, name).convention())
    if "shutter_motion" in ours and how.shutter_motion.over == "frame":
        ours["shutter_motion"] = ours["shutter_motion"] * np.float32(how.shutter)
    for name in DEPTHS:
        if name in ours:
            ours[name] = _depth(ours[name], how, camera, aspect)
    if "position" in ours and "depth" not in ours:  # some producers write infinity or NaN for a miss
        ours["position"] = np.where(np.isfinite(ours["position"]).all(0), ours["position"], 0)
    return without_misses(ours, how)


def without_misses(given: Mapping[str, Pixels], how: ChannelMap) -> dict[str, Pixels]:
    """Set what describes surfaces, channels (C, H, W) of one frame, to 0 in misses; as they are without `depth`.

    Surfaces with the instance 0, which means a miss, get the instance UNNAMED. Vectors of misses become NaN where the
    map `how` calls the sky's unknown.
    """
    ours = dict(given)
    if "depth" in ours:
        hit, of_surfaces = ours["depth"] > 0, (*NORMALS, "position", "instance")
        ours |= {name: np.where(hit, ours[name], 0) for name in of_surfaces if name in ours}
        if "instance" in ours:
            ours["instance"] = np.where(hit & (ours["instance"] == 0), np.float32(UNNAMED), ours["instance"])
        for name, source in how.channels.items():
            if name in ours and SKY in source.unknown:
                ours[name] = np.where(hit, ours[name], np.nan)
    return ours


def _depth(stored: Pixels, how: ChannelMap, camera: Camera | None, aspect: float) -> Pixels:
    """Convert stored depth to depth (1, H, W) along the view axis in scene units, 0 for misses.

    The sky is infinite already (`nte.importing.layers.read`).
    """
    counted = stored * np.float32(np.sign(how.depth.scale))
    hit = (counted > 0) & (counted < np.inf)  # false for NaN
    if how.depth.along == "ray":
        camera = camera or camera_of_fov(how.vertical_fov, stored.shape[1:], aspect)
        counted = counted * cosine_to_axis(camera, stored)
    return np.where(hit, np.where(hit, counted, 0) * np.float32(abs(how.depth.scale)), 0).astype(np.float32)


def convert_vectors(vectors: Pixels, convention: Convention) -> Pixels:
    """Convert vectors (2, H, W) that follow `convention`, not a forward one, to nte's.

    Nte's vectors are in pixels, x to the right, y down, from this frame to the other one.
    """
    factors = np.asarray(convention.factors(*vectors.shape[-2:]), vectors.dtype)
    return np.ascontiguousarray((vectors[::-1] if convention.swapped else vectors) * factors[:, None, None])


def revert_vectors(vectors: Pixels, convention: Convention) -> Pixels:
    """Convert nte's vectors (2, H, W) to those that the producer stored: the inverse of `convert_vectors`."""
    given = vectors / convert_vectors(np.ones_like(vectors), convention)
    return np.ascontiguousarray(given[::-1] if convention.swapped else given)


def decoded(stored: Pixels) -> Pixels:
    """Decode directions (3, H, W) stored as n/2 + 1/2.

    What is no surface is 0: no unit vector is stored as 0, nor as the middle, which bytes and half floats round.
    """
    direction = 2 * stored - 1
    return np.where(stored.any(0) & (np.abs(direction) > LEAST_NORMAL).any(0), direction, 0)


def unit(vectors: npt.NDArray[np.floating]) -> npt.NDArray[np.float64]:
    """Normalise vectors (3, …) to length 1; zero and non-finite ones become 0."""
    with np.errstate(over="ignore"):
        length = np.linalg.norm(vectors, axis=0, keepdims=True)
    usable = (length > 0) & np.isfinite(length)
    return np.where(usable, vectors / np.where(usable, length, 1), 0)


def cosine_to_axis(camera: Camera, like: Pixels) -> Pixels:
    """Return the cosine (1, H, W) between every pixel's ray and the view axis, for the size of `like` (…, H, W)."""
    with _pytorch_for("distances from the camera as depth"):
        import torch

        from nte.motion.camera import points_from_depth
    view, projection = (torch.from_numpy(np.asarray(matrix, np.float32))[None] for matrix in camera)
    rays = points_from_depth(torch.zeros(1, 1, *like.shape[-2:]), view, projection)[0].numpy()
    along = np.einsum("j,jhw->hw", camera.view[2, :3] / np.linalg.norm(camera.view[2, :3]), rays)
    return np.asarray(np.abs(along)[None] / np.linalg.norm(rays, axis=0), np.float32)


def with_motion(frames: Iterable[dict[str, Pixels]]) -> Iterator[dict[str, Pixels]]:
    """Make the `motion` of frames that have only `forward_motion`; yield other frames as they are.

    The forward vectors of the previous frame are followed to this one; where several arrive, the nearest surface wins.
    A pixel where none arrives was hidden: it gets the motion of the neighbour that is nearest in depth. The first
    frame has no history, so its motion is 0. Arrays are (C, H, W).
    """
    before: dict[str, Pixels] | None = None
    for frame in frames:
        if "forward_motion" in frame and "motion" not in frame:
            if before is None:
                motion = np.zeros_like(frame["forward_motion"])
            else:
                with _pytorch_for("forward vectors alone"):
                    import torch

                    from nte.motion.geometric import scatter_forward_motion
                depths = [f.get("depth", np.zeros_like(frame["color"][:1])) for f in (before, frame)]
                scattered = scatter_forward_motion(
                    torch.from_numpy(before["forward_motion"])[None], torch.from_numpy(depths[0])[None]
                )
                motion = _fill(scattered[0].numpy(), depths[1])
            before = frame
            frame = {**frame, "motion": motion}
        yield frame


@contextmanager
def _pytorch_for(what: str) -> Iterator[None]:
    """Name the extra that brings PyTorch, without which other frames are read."""
    try:
        yield
    except ImportError as error:
        raise needs_extra("import", what, error) from error


def fill_unknown(frame: Mapping[str, Pixels]) -> dict[str, Pixels]:
    """Fill a frame's unknown (NaN) vectors from neighbours, the nearest in depth first; with 0 if none is known.

    Positions that are not finite become 0. Arrays are (C, H, W).
    """
    filled = dict(frame)
    if "position" in frame:
        filled["position"] = np.where(np.isfinite(frame["position"]).all(0), frame["position"], 0)
    for name in VECTORS:
        if name in frame and np.isnan(frame[name]).any():
            filled[name] = _fill(frame[name], frame.get("depth", np.zeros_like(frame[name][:1])))
    return filled


def _fill(motion: Pixels, depth: Pixels) -> Pixels:
    """Fill the NaN pixels of motion (2, H, W), ring by ring, from the neighbour that is nearest in depth (1, H, W).

    The sky counts as behind everything, so it takes the motion of other sky, or else of the furthest surface. Pixels
    further than _RINGS from anything known take the mean of the known pixels around them.
    """
    filled = motion.copy()
    behind = np.where(depth > 0, depth, np.float32(2 * depth.max() + 1))
    for _ in range(_RINGS):
        _fill_ring(filled, behind[0])
    return _fill_from_coarser(filled)


def _fill_ring(motion: Pixels, depth: Pixels) -> None:
    """Fill, in place, the unknown pixels of motion (2, H, W) that have a known neighbour; depth (H, W)."""
    known = np.pad(~np.isnan(motion[0]), 1)
    height, width = depth.shape
    windows = [(slice(dy, dy + height), slice(dx, dx + width)) for dy, dx in product(range(3), range(3))]
    y, x = np.nonzero(np.any([known[window] for window in windows], axis=0) & ~known[1:-1, 1:-1])
    nearest, best = np.full(y.shape, np.inf), np.zeros((2, *y.shape), np.float32)
    for dy, dx in product((-1, 0, 1), (-1, 0, 1)):
        there = known[y + dy + 1, x + dx + 1]
        row, column = (y + dy).clip(0, height - 1), (x + dx).clip(0, width - 1)
        apart = np.where(there, np.abs(depth[row, column] - depth[y, x]), np.inf)
        best = np.where(apart < nearest, motion[:, row, column], best)
        nearest = np.minimum(nearest, apart)
    motion[:, y, x] = best


def _fill_from_coarser(motion: Pixels) -> Pixels:
    """Fill the NaN pixels of motion (2, H, W) from the image at half the size, filled likewise; 0 if all are NaN."""
    known = ~np.isnan(motion[:1])
    if known.all() or not known.any():
        return np.nan_to_num(motion, nan=0)
    height, width = motion.shape[1:]
    even = ((0, 0), (0, height % 2), (0, width % 2))
    blocks = (-1, (height + 1) // 2, 2, (width + 1) // 2, 2)
    total = np.pad(np.where(known, motion, 0), even).reshape(blocks).sum((2, 4))
    count = np.pad(known, even).reshape(blocks).sum((2, 4))
    coarse = np.where(count > 0, total / np.maximum(count, 1), np.nan).astype(np.float32)
    spread = _fill_from_coarser(coarse).repeat(2, 1).repeat(2, 2)
    return np.where(known, motion, spread[:, :height, :width])
