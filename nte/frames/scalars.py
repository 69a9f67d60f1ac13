"""The two numbers that belong to a whole sequence: exposure and depth scale.

They are estimated once, from the first frame, and carried in the state. In NumPy, so that the runtime
without PyTorch computes the same values as training.
"""

import numpy as np
import numpy.typing as npt

from nte.errors import NteError
from nte.frames.frame import Array, Frame

MIDDLE_GREY = 0.18
# A pixel that is 10⁴ times as bright as a block than which a tenth is brighter: a firefly, a fault or the sun.
SPIKE, TENTH = 1e4, 0.9
_BLOCK = 8
FARTHEST = 1e15  # scene units: beyond, a depth is a miss
_BRIGHTEST = 1e30  # the sum of a block of such samples is still finite
_REC709 = np.array([0.2126, 0.7152, 0.0722], np.float32)


def sequence_scalars(frame: Frame) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    """(exposure (N,), depth_scale (N,)): the frame's own where it has them, else estimated from it.

    Raises NteError where the frame's own are no positive numbers.
    """
    exposure, depth_scale = (np.nan_to_num(scalar, nan=1.0) for scalar in known_scalars(frame))
    return exposure, depth_scale


def known_scalars(frame: Frame) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    """(exposure (N,), depth_scale (N,)) as `sequence_scalars`, but NaN where a frame without light or surface tells
    nothing: the next one may."""
    exposure = given_exposure(frame)
    if exposure is None:
        exposure = known_exposure(_as_numpy(frame["color"]))
    depth_scale = _given(frame, "depth_scale")
    if depth_scale is None:
        depth = frame.get("depth")
        depth_scale = np.ones(frame.batch, np.float32) if depth is None else _known_depth(_as_numpy(depth))
    return exposure, depth_scale


def given_exposure(frame: Frame) -> npt.NDArray[np.float32] | None:
    """The frame's own exposure (N,), or None. Raises NteError where it is no positive number."""
    return _given(frame, "exposure")


def estimate_exposure(color: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """Linear factor (N,) that brings a noisy frame (N, 3, H, W) to middle grey: 0.18 / exp(mean log luminance).

    The luminance is that of 8×8 blocks, and blocks without light are left out: at 1 spp many pixels are
    black, and the logarithm would measure the noise instead of the light. Bad pixels count as 0, and so does
    one that is 10⁴ times as bright as all but a tenth of the blocks. 1 for a frame without any light.
    """
    return np.nan_to_num(known_exposure(color), nan=1.0)


def known_exposure(color: npt.NDArray[np.float32], lit: float = 0.0) -> npt.NDArray[np.float32]:
    """As `estimate_exposure`, but NaN where not more than this share of the blocks has light."""
    usable = np.where((color >= 0) & np.isfinite(color), color, 0).clip(max=_BRIGHTEST)
    luminance = np.einsum("nchw,c->nhw", usable, _REC709)
    height, width = (max(1, size // _BLOCK) * min(size, _BLOCK) for size in luminance.shape[1:])
    parts = luminance[:, :height, :width]
    return np.asarray([_exposure(_without_spikes(image), lit) for image in parts], np.float32)


def sequence_exposure(frame: Frame, carried: Array | None) -> npt.NDArray[np.float32]:
    """Exposure (N,) of a sequence: what is carried from the frame before, once it is known; NaN until then.

    A sequence that starts with this frame (`reset`) carries nothing.
    """
    own = np.full(frame.batch, np.nan, np.float32) if carried is None else _as_numpy(carried)
    if frame.reset is not None:
        own = np.where(_as_numpy(frame.reset) > 0, np.float32(np.nan), own)
    return np.where(np.isnan(own), known_scalars(frame)[0], own) if np.isnan(own).any() else own


def median_depth(depth: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """Median depth (N,) of the pixels of (N, 1, H, W) that hit a surface, in scene units; 1 where none does."""
    return np.nan_to_num(_known_depth(depth), nan=1.0)


def _known_depth(depth: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    hits = (d[(d > 0) & (d <= FARTHEST)] for d in depth)
    return np.asarray([np.median(hit) if hit.size else np.nan for hit in hits], np.float32)


def _without_spikes(luminance: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """Luminance (H, W) with its spikes black."""
    blocks = _blocks(luminance)
    if not (blocks > 0).any():
        return luminance
    usual = np.quantile(blocks[blocks > 0], TENTH, method="lower")
    return np.where(luminance <= SPIKE * usual, luminance, np.float32(0))


def _exposure(luminance: npt.NDArray[np.float32], lit: float) -> np.float32:
    blocks = _blocks(luminance)
    light = blocks[blocks > 0]
    if light.size <= lit * blocks.size:
        return np.float32(np.nan)
    return np.float32(MIDDLE_GREY / np.exp(np.log(light).mean()))


def _blocks(luminance: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """Means over 8×8 pixels of (H, W), which divides by 8 or is smaller."""
    height, width = luminance.shape
    bh, bw = min(height, _BLOCK), min(width, _BLOCK)
    return np.asarray(luminance.reshape(height // bh, bh, width // bw, bw).mean((1, 3)))


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
