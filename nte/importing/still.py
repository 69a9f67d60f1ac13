"""Motion and depth of scenes in which only the camera moves, from the world position of every pixel."""

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from nte.errors import NteError
from nte.frames.clip import Pixels
from nte.importing.cameras import Camera
from nte.importing.sky import OUTSIDE, Floats, recover_camera

Mask = npt.NDArray[np.bool_]


def with_still_geometry(
    frames: Iterable[dict[str, Pixels]], files: Sequence[Path], cameras: Sequence[Camera] = ()
) -> Iterator[dict[str, Pixels]]:
    """Make the `motion` and `depth` that frames with `position` lack; yield other frames as they are.

    files: the files that hold `position`, named in errors. cameras: one per frame; if there are none, they are
    recovered from the positions, and NteError is raised if that fails. Without `depth`, a pixel is a miss if its
    position is not finite or 0, or its normal is 0; the motion of a miss is unknown (NaN). The first frame has no
    history, so its motion is 0. Motion starts where the position is seen now, not at the pixel's centre, so it
    contains no jitter. Arrays are (C, H, W).
    """
    before: Floats | None = None
    for index, frame in enumerate(frames):
        if "position" in frame:
            hit = _hit(frame)
            now = cameras[index].to_pixels(hit.shape[1:]) if cameras else recover_camera(frame["position"], hit[0])
            if now is None:
                raise NteError(
                    f"{files[index]}: 'position' does not say where the camera is (few points, one plane, or no "
                    "perspective): give 'cameras'"
                )
            now = now / np.linalg.norm(now[2, :3])  # so that the divisor is the depth
            if "depth" not in frame:
                seen = np.tensordot(now[2, :3], frame["position"], 1) + now[2, 3]
                frame = {**frame, "depth": np.where(hit, seen[None], 0).astype(np.float32)}
            if "motion" not in frame:
                frame = {**frame, "motion": _motion(frame["position"], hit, now, before)}
            before = now
        yield frame


def _hit(frame: dict[str, Pixels]) -> Mask:
    """Bool mask (1, H, W) of the pixels that show a surface."""
    if "depth" in frame:
        return np.asarray(frame["depth"] > 0)
    there = np.isfinite(frame["position"]).all(0) & frame["position"].any(0)
    facing = np.asarray(frame.get("normal", frame["position"])).any(0)
    return np.asarray(there & facing)[np.newaxis]


def _motion(position: Pixels, hit: Mask, now: Floats, before: Floats | None) -> Pixels:
    size = position.shape[1:]
    if before is None:
        return np.zeros((2, *size), np.float32)
    then = np.nan_to_num(_seen(position, before), nan=OUTSIDE * max(size))
    return np.where(hit, then - _seen(position, now), np.nan).astype(np.float32)


def _seen(position: Pixels, camera: Floats) -> Floats:
    with np.errstate(divide="ignore", invalid="ignore"):  # a position may hold any value, even infinity
        x, y, w = np.tensordot(camera[:, :3], position.astype(np.float64), 1) + camera[:, 3].reshape(3, 1, 1)
        return np.asarray(np.stack([x, y]) / np.where(w > 0, w, np.nan))
