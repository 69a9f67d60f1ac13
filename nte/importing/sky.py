"""Motion of the sky: a point at infinity, which only the camera's rotation moves.

A camera is a matrix (3, 4) here, from world points to homogeneous pixels: x, y and the depth that divides them.
"""

from collections.abc import Iterable, Iterator, Sequence

import numpy as np
import numpy.typing as npt

from nte.frames.clip import Pixels
from nte.importing.cameras import Camera

Floats = npt.NDArray[np.float64]
OUTSIDE = -2.0  # image sizes: the place of a point behind the camera, so that its vector is finite
_ENOUGH = 100  # least number of surface points
_AT_MOST = 50_000  # surface points that are used, up to twice as many: more cost memory and add nothing
_FLAT = 1e-3  # smaller relative extents mean points in a plane; smaller relative changes of depth, no perspective
_OWN_PIXEL = 1.0  # px: largest error of the recovered camera


def motion_at_infinity(camera: Floats, other: Floats, size: tuple[int, ...]) -> Pixels:
    """Compute vectors (2, H, W), in pixels, from each pixel's centre to where the `other` camera sees the same ray.

    size: (height, width). A ray behind the other camera gets a vector out of the image.
    """
    centres = pixel_centres(size)
    ray = np.linalg.inv(camera[:, :3]) @ np.stack([*centres, np.ones(size)]).reshape(3, -1)
    x, y, w = (other[:, :3] @ ray).reshape(3, *size)
    then = np.stack([x, y]) / np.where(w > 0, w, np.nan)
    return np.nan_to_num(then - centres, nan=OUTSIDE * max(size)).astype(np.float32)


def recover_camera(position: Pixels, hit: npt.NDArray[np.bool_]) -> Floats | None:
    """Recover the camera (3, 4) that sees the world points `position` (3, H, W) at their own pixels.

    hit: bool mask (H, W) of the pixels whose points count. Uses the direct linear transformation: least squares over
    the finite points, fewer than 100 000 of them. Returns None if the points do not determine a camera: too few, all
    in one plane, or not seen in perspective (orthographic, panoramic).
    """
    hit = hit & np.isfinite(position).all(0)
    some = slice(None, None, max(1, int(hit.sum()) // _AT_MOST))
    points, seen = position[:, hit][:, some].astype(np.float64), pixel_centres(hit.shape)[:, hit][:, some]
    if points.shape[1] < _ENOUGH:
        return None
    centre, size = points.mean(1, keepdims=True), max(hit.shape)
    extent = np.sqrt(np.linalg.eigvalsh(np.cov(points)))
    if not extent[0] > _FLAT * extent[-1]:
        return None
    # Points and pixels are scaled to unit size, or the squares below would lose all digits.
    near = np.concatenate([(points - centre) / extent[-1], np.ones((1, points.shape[1]))])
    u, v = seen / size
    rows = np.block([[near.T, 0 * near.T, -u[:, None] * near.T], [0 * near.T, near.T, -v[:, None] * near.T]])
    found = np.linalg.eigh(rows.T @ rows)[1][:, 0].reshape(3, 4)
    x, y, w = found @ near
    if w.mean() < 0:
        found, x, y, w = -found, -x, -y, -w
    off = np.hypot(x / w - u, y / w - v) * size
    if (w <= 0).any() or np.std(w) < _FLAT * np.mean(w) or np.median(off) > _OWN_PIXEL:
        return None
    to_near = np.eye(4)
    to_near[:3] = np.concatenate([np.eye(3), -centre], 1) / extent[-1]
    return np.asarray(np.diag([size, size, 1.0]) @ found @ to_near)


def with_sky_motion(frames: Iterable[dict[str, Pixels]], cameras: Sequence[Camera] = ()) -> Iterator[dict[str, Pixels]]:
    """Set the unknown (NaN) `motion` and `forward_motion` of misses to that of the camera's rotation; yield the frames.

    cameras: one per frame; if there are none, they are recovered from `position` and `depth`. Vectors stay NaN if
    this frame or the other one has no camera: `motion` of the first frame, `forward_motion` of the last one.
    """
    before: Floats | None = None
    waiting: dict[str, Pixels] | None = None
    for index, frame in enumerate(frames):
        now = None
        if cameras:
            now = cameras[index].to_pixels(frame["color"].shape[1:])
        elif {"position", "depth"} <= set(frame):
            now = recover_camera(frame["position"], frame["depth"][0] > 0)
        if waiting is not None:
            _set_sky(waiting, "forward_motion", before, now)
            yield waiting
        _set_sky(frame, "motion", now, before)
        before, waiting = now, frame
    if waiting is not None:
        yield waiting


def _set_sky(frame: dict[str, Pixels], name: str, camera: Floats | None, other: Floats | None) -> None:
    if {name, "depth"} <= set(frame) and camera is not None and other is not None:
        unknown = np.isnan(frame[name]) & (frame["depth"] <= 0)
        if unknown.any():
            frame[name] = np.where(unknown, motion_at_infinity(camera, other, unknown.shape[1:]), frame[name])


def pixel_centres(size: tuple[int, ...]) -> Floats:
    """Return the centres (2, H, W) of all pixels, x first; the upper left one is at (0.5, 0.5)."""
    y, x = np.mgrid[: size[0], : size[1]] + 0.5
    return np.stack([x, y])
