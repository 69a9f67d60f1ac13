"""Cameras of an imported sequence: read from JSON, or made from a field of view."""

import json
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from nte.errors import NteError

_LARGEST = 1e38  # the largest number that a frame's float32 matrices can hold, roughly
_FARTHEST = 8.0  # images: a crop may lie beside the view axis, but not this far away
_CORNER = 0.02  # images: a view axis this close to the upper left corner is the centre of [−1, 1], moved by jitter


class Camera(NamedTuple):
    """A camera's matrices (4, 4) for column vectors: world → view, and view → homogeneous [0, 1]² with y down."""

    view: npt.NDArray[np.float64]
    projection: npt.NDArray[np.float64]

    def to_pixels(self, size: tuple[int, ...]) -> npt.NDArray[np.float64]:
        """Return the matrix (3, 4) from world points to homogeneous pixels of an image of `size` (height, width)."""
        return np.asarray(np.diag([size[1], size[0], 1.0]) @ (self.projection @ self.view)[[0, 1, 3]])


def load_cameras(path: Path, frames: int) -> list[Camera]:
    """Read the cameras of a JSON file: a list of {"view", "projection"}, one entry per frame.

    Raises NteError if the file cannot be read or holds anything else, if the number of cameras is not `frames`, and
    for a matrix that is not 4×4, finite and invertible, for row vectors, orthographic, or to [−1, 1].
    """
    try:
        listed = json.loads(path.read_text(encoding="utf-8-sig"))  # Windows PowerShell writes the mark
        found = [Camera(*(np.array(c[key], np.float64) for key in Camera._fields)) for c in listed]
    except OSError as error:
        raise NteError(f"{path}: cannot be read: {error.strerror}") from error
    except (ValueError, TypeError, KeyError, OverflowError, RecursionError) as error:
        raise NteError(f"{path}: expected a JSON list of view and projection matrices: {error}") from error
    if len(found) != frames:
        raise NteError(f"{path}: {len(found)} cameras for {frames} frames")
    for i, camera in enumerate(found):
        for key, matrix in camera._asdict().items():
            if matrix.shape != (4, 4) or not (np.abs(matrix) < _LARGEST).all() or np.linalg.det(matrix) == 0:
                raise NteError(f"{path}: camera {i}: '{key}' is not an invertible 4×4 matrix")
        if not np.allclose(camera.view[3], (0, 0, 0, 1), rtol=0, atol=1e-6):
            raise NteError(
                f"{path}: camera {i}: the last row of 'view' is not 0 0 0 1: transpose matrices of row vectors"
            )
        if np.linalg.det(camera.to_pixels((1, 1))[:, :3]) == 0:
            raise NteError(f"{path}: camera {i}: 'projection' is orthographic: expected that of a perspective camera")
        middle = camera.projection[:2, 2] / camera.projection[3, 2]
        if (np.abs(middle) < _CORNER).all() or (np.abs(middle) > _FARTHEST).any():
            raise NteError(
                f"{path}: camera {i}: 'projection' puts the view axis at {middle[0]:.4g} {middle[1]:.4g}: expected "
                "[0, 1] over the image from its upper left corner, so about 0.5 0.5; not [−1, 1] and not pixels"
            )
    return found


def camera_of_fov(vertical_fov: float, size: tuple[int, ...], aspect: float = 1.0) -> Camera:
    """Make a centred perspective camera at the origin that looks along +z.

    vertical_fov: in degrees. size: (height, width) in pixels. aspect: a pixel's width in units of its height.
    """
    near, far = 0.1, 100.0
    focal = 0.5 / np.tan(np.radians(vertical_fov) / 2)
    projection = np.array(
        [
            [focal * size[0] / (size[1] * aspect), 0, 0.5, 0],
            [0, -focal, 0.5, 0],
            [0, 0, far / (far - near), -near * far / (far - near)],
            [0, 0, 1, 0],
        ]
    )
    return Camera(np.diag([1.0, 1.0, 1.0, 1.0]), projection)
