"""The two numbers that belong to a whole sequence: exposure and depth scale.

They are estimated once, from the first frame, and carried in the state. In NumPy, so that the runtime
without PyTorch computes the same values as training.
"""

import numpy as np
import numpy.typing as npt

from nte.errors import NteError
from nte.frames.frame import Array, Frame

MIDDLE_GREY = 0.18
_BLOCK = 8
_BRIGHTEST = 1e30  # what `sanitise` leaves of a sample; the sum of a block is still finite
_REC709 = np.array([0.2126, 0.7152, 0.0722], np.float32)


def sequence_scalars(frame: Frame) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    """(exposure (N,), depth_scale (N,)): the frame's own where it has them, else estimated from it.

    Raises NteError where the frame's own are no positive numbers.
    """
    exposure = _given(frame, "exposure")
    if exposure is None:
        exposure = estimate_exposure(_as_numpy(frame["color"]))
    depth_scale = _given(frame, "depth_scale")
    if depth_scale is None:
        depth = frame.get("depth")
        depth_scale = np.ones(frame.batch, np.float32) if depth is None else median_depth(_as_numpy(depth))
    return exposure, depth_scale


def estimate_exposure(color: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """Linear factor (N,) that brings a noisy frame (N, 3, H, W) to middle grey: 0.18 / exp(mean log luminance).

    The luminance is that of 8×8 blocks, and blocks without light are left out: at 1 spp many pixels are
    black, and the logarithm would measure the noise instead of the light. Bad pixels count as 0.
    1 for a frame without any light.
    """
    usable = np.where((color >= 0) & np.isfinite(color), color, 0).clip(max=_BRIGHTEST)
    luminance = np.einsum("nchw,c->nhw", usable, _REC709)
    height, width = (max(1, size // _BLOCK) * min(size, _BLOCK) for size in luminance.shape[1:])
    bh, bw = min(height, _BLOCK), min(width, _BLOCK)
    blocks = luminance[:, :height, :width].reshape(-1, height // bh, bh, width // bw, bw).mean((2, 4))
    means = [np.log(b[b > 0]).mean() if (b > 0).any() else np.log(MIDDLE_GREY) for b in blocks]
    return np.asarray(MIDDLE_GREY / np.exp(means), np.float32)


def median_depth(depth: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """Median depth (N,) of the pixels of (N, 1, H, W) that hit a surface, in scene units; 1 where none does."""
    hits = (d[(d > 0) & np.isfinite(d)] for d in depth)
    return np.asarray([np.median(hit) if hit.size else 1.0 for hit in hits], np.float32)


def _given(frame: Frame, name: str) -> npt.NDArray[np.float32] | None:
    value = getattr(frame, name)
    if value is None:
        return None
    numbers = _as_numpy(value)
    if numbers.shape not in ((), (1,), (frame.batch,)) or not (np.isfinite(numbers) & (numbers > 0)).all():
        found = numbers.tolist()
        raise NteError(f"frame {frame.index}: {name} is {found}, expected a positive number, one for each sequence")
    return np.array(np.broadcast_to(numbers, (frame.batch,)), np.float32)


def _as_numpy(array: Array) -> npt.NDArray[np.float32]:
    return np.asarray(array.detach().cpu() if hasattr(array, "detach") else array, np.float32)
