"""The two numbers that belong to a whole sequence: exposure and depth scale.

They are estimated once, from the first frame, and carried in the state. They are computed in NumPy, so that the
runtime without PyTorch gets the same values as training.
"""

import numpy as np
import numpy.typing as npt

from nte.errors import NteError
from nte.frames.frame import Array, Frame

MIDDLE_GREY = 0.18
# A spike is SPIKE times as bright as the TENTH quantile of the lit blocks: a firefly, a fault or the sun.
SPIKE, TENTH = 1e4, 0.9
_BLOCK = 8
FARTHEST = 1e15  # scene units; a larger depth is a miss
_BRIGHTEST = 1e30  # samples are clipped here, so that the sum over a block is finite
_REC709 = np.array([0.2126, 0.7152, 0.0722], np.float32)


def sequence_scalars(frame: Frame) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    """Return (exposure (N,), depth_scale (N,)) of a frame: its own if it has them, else estimated from its pixels.

    exposure: linear factor to middle grey, see `estimate_exposure`; 1 for a frame without light. depth_scale: median
    depth in scene units; 1 for a frame without a surface or without depth. Raises NteError if the frame's own values
    are not positive numbers.
    """
    exposure, depth_scale = (np.nan_to_num(scalar, nan=1.0) for scalar in known_scalars(frame))
    return exposure, depth_scale


def known_scalars(frame: Frame) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    """Return (exposure (N,), depth_scale (N,)) of a frame, NaN where it has no light or no surface to tell.

    Values are those of `sequence_scalars` otherwise; after a NaN the next frame may know more. Raises NteError if the
    frame's own values are not positive numbers, and for a frame with neither exposure nor `color`.
    """
    exposure = given_exposure(frame)
    if exposure is None:
        if "color" not in frame:
            raise NteError(
                f"frame {frame.index}: no exposure, and no channel 'color' to measure it from; it has "
                f"{', '.join(frame.channels)}: give either"
            )
        exposure = known_exposure(_as_numpy(frame["color"]))
    depth_scale = _given(frame, "depth_scale")
    if depth_scale is None:
        depth = frame.get("depth")
        depth_scale = np.ones(frame.batch, np.float32) if depth is None else _known_depth(_as_numpy(depth))
    return exposure, depth_scale


def given_scalars(frame: Frame) -> tuple[npt.NDArray[np.float32] | None, npt.NDArray[np.float32] | None]:
    """Return the frame's own (exposure (N,), depth_scale (N,)), None for one that it lacks.

    Raises NteError if they are not positive numbers.
    """
    return _given(frame, "exposure"), _given(frame, "depth_scale")


def given_exposure(frame: Frame) -> npt.NDArray[np.float32] | None:
    """Return the frame's own exposure (N,), or None if it has none. Raises NteError if it is not positive."""
    return _given(frame, "exposure")


def estimate_exposure(color: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """Estimate the linear factor (N,) that brings a noisy frame (N, 3, H, W) to middle grey.

    The factor is 0.18 / exp(mean log luminance). The luminance is the mean over 8×8 blocks, and blocks without light
    are left out: at 1 spp many pixels are black, and the logarithm would measure the noise instead of the light. Bad
    components count as 0, and so does a pixel that is more than 10⁴ times as bright as nine tenths of the lit blocks.
    The factor is 1 for a frame without any light.
    """
    return np.nan_to_num(known_exposure(color), nan=1.0)


def known_exposure(color: npt.NDArray[np.float32], lit: float = 0.0) -> npt.NDArray[np.float32]:
    """Estimate the exposure (N,) of color (N, 3, H, W) as `estimate_exposure` does, NaN where it is unknown.

    It is unknown unless more than the share `lit` of the 8×8 blocks has light.
    """
    usable = np.where((color >= 0) & np.isfinite(color), color, 0).clip(max=_BRIGHTEST)
    luminance = np.einsum("nchw,c->nhw", usable, _REC709)
    height, width = (max(1, size // _BLOCK) * min(size, _BLOCK) for size in luminance.shape[1:])
    parts = luminance[:, :height, :width]
    return np.asarray([_exposure(_without_spikes(image), lit) for image in parts], np.float32)


def sequence_exposure(frame: Frame, carried: Array | None) -> npt.NDArray[np.float32]:
    """Return the exposure (N,) of a sequence: what the frame gives, else the carried one, else that of its pixels.

    carried: the exposure (N,) that the previous frame returned, or None at the start. A sequence that starts with
    this frame (`reset`) ignores it. NaN until a frame has light.
    """
    given = given_exposure(frame)
    if given is not None:
        return given
    own = np.full(frame.batch, np.nan, np.float32) if carried is None else _as_numpy(carried)
    if frame.reset is not None:
        own = np.where(_as_numpy(frame.reset) > 0, np.float32(np.nan), own)
    return np.where(np.isnan(own), known_scalars(frame)[0], own) if np.isnan(own).any() else own


def median_depth(depth: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """Return the median depth (N,), scene units, of the pixels of (N, 1, H, W) that hit a surface; 1 if none does."""
    return np.nan_to_num(_known_depth(depth), nan=1.0)


def _known_depth(depth: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    hits = (d[(d > 0) & (d <= FARTHEST)] for d in depth)
    return np.asarray([np.median(hit) if hit.size else np.nan for hit in hits], np.float32)


def _without_spikes(luminance: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """Luminance (H, W) with its spikes set to 0."""
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
    """Means over 8×8 pixels of (H, W); each side is a multiple of 8 or below 8."""
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
