"""Where world points are seen: pixel positions, x to the right, y down, the first pixel's centre at 0.5. NumPy."""

import numpy as np
import numpy.typing as npt

from nte.render.engine.mesh_stage import Stage
from nte.render.world.transforms import Floats


def eye(stage: Stage, time: float) -> Floats:
    """Where the camera is (3,), world, at a time in frames."""
    return np.asarray(stage.scene.camera.track(time)[:3, 3])


def pixel_positions(stage: Stage, points: Floats, time: float, hit: npt.NDArray[np.bool_] | None = None) -> Floats:
    """Pixel positions (R, 2) of world points (R, 3) at a time in frames; NaN behind the camera.

    Where `hit` (R,) is false, the point is a direction: a point at infinity, which only the camera's turning moves.
    """
    clip = _clip(stage, points, time, hit)
    with np.errstate(divide="ignore", invalid="ignore"):
        position = clip[:, :2] / clip[:, 2:]
    position[~(clip[:, 2] > 0)] = np.nan
    return np.asarray(position)


def _clip(stage: Stage, points: Floats, time: float, hit: npt.NDArray[np.bool_] | None = None) -> Floats:
    """Homogeneous pixel coordinates (R, 3): x·w, y·w, w."""
    camera = stage.scene.camera
    matrix = camera.projection(stage.width, stage.height) @ camera.view(time)
    rows = matrix[[0, 1, 3]] * np.array([[stage.width], [stage.height], [1]])
    origin = rows[:, 3] if hit is None else rows[:, 3] * hit[:, None]
    # Not @: BLAS would start threads, beside kernels that have all cores.
    return np.asarray(np.einsum("rk,ck->rc", points, rows[:, :3]) + origin)
