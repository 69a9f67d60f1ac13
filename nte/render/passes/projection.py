"""Projection of world points to pixel positions: x to the right, y down, the first pixel's centre at 0.5. NumPy."""

import numpy as np
import numpy.typing as npt

from nte.render.engine.stage import Timeless
from nte.render.world.transforms import Floats


def eye(timeless: Timeless, time: float) -> Floats:
    """Return the camera's position (3,), world, at a time in frames."""
    return np.asarray(timeless.camera.track(time)[:3, 3])


def pixel_positions(
    timeless: Timeless, points: Floats, time: float, hit: npt.NDArray[np.bool_] | None = None
) -> Floats:
    """Project world points (R, 3) to pixel positions (R, 2) at a time in frames; NaN behind the camera.

    Where `hit` (R,) is false, the point is a direction: a point at infinity, which only the camera's rotation moves.
    """
    clip = _clip(timeless, points, time, hit)
    with np.errstate(divide="ignore", invalid="ignore"):
        position = clip[:, :2] / clip[:, 2:]
    position[~(clip[:, 2] > 0)] = np.nan
    return np.asarray(position)


def _clip(timeless: Timeless, points: Floats, time: float, hit: npt.NDArray[np.bool_] | None = None) -> Floats:
    """Homogeneous pixel coordinates (R, 3): x·w, y·w, w."""
    matrix = timeless.camera.projection(timeless.width, timeless.height) @ timeless.camera.view(time)
    rows = matrix[[0, 1, 3]] * np.array([[timeless.width], [timeless.height], [1]])
    origin = rows[:, 3] if hit is None else rows[:, 3] * hit[:, None]
    # Not @: BLAS would start threads beside kernels that already use all cores.
    return np.asarray(np.einsum("rk,ck->rc", points, rows[:, :3]) + origin)
