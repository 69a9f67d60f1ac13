"""Noisy light accumulated over time before a spatial denoiser, for as long as nothing says that it has changed.

A spatial denoiser takes all that it averages for one light. Light that lags behind, or a texture between two pixels,
stays in its image, while noise does not. So a pixel keeps as much of its history as the error of that history, seen
over a neighbourhood, does not stand out from the noise:

- light that has changed differs from its history in one direction all over a neighbourhood;
- a surface is fetched from the nearest pixel, half a pixel off at most, which errs by its slope.

Nearest, not bilinear: a mean of neighbours has noise of another grain, which denoisers take for detail. What was
measured is in docs/experiments.md. Everything is NumPy, so that exported models can build on it without PyTorch.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from nte.frames.clip import Pixels
from nte.frames.scalars import known_exposure

Mask = npt.NDArray[np.bool_]

BLOCK = 4  # px; changes are looked for in means over blocks of this size
NEAR, FAR = 3.0, 10.0  # px; standard deviations of the neighbourhoods in which they are looked for
NOISE = 2.0  # px; that of the neighbourhood whose noise is measured
DOUBT = 3.0  # significance (mean² / variance of the mean) of a difference at which a half of the history goes
SLOPE = 8.0  # weight of the squared error that half a pixel makes on a slope
FLOOR = 0.3  # added to the albedo before light is divided by it
HIDDEN_PX = 0.5  # the paper's rule for hidden surfaces, as in nte.motion.geometric
BEHIND = 1.1
REC709 = np.array([0.2126, 0.7152, 0.0722], np.float32)


class Surface(NamedTuple):
    """What is known of a frame's surfaces: images (H, W, C), or None."""

    albedo: Pixels | None
    motion: Pixels | None  # (H, W, 2) px, current → previous; NaN = unknown
    depth: Pixels | None  # (H, W, 1), scene units, 0 = miss
    forward: Pixels | None  # (H, W, 2) px, on the previous frame, to this one; NaN = unknown


class History(NamedTuple):
    """What a frame leaves to the next one."""

    light: Pixels  # (H, W, 3): mean light, divided by the texture
    log: Pixels  # (H, W): mean logarithm of 1 + its exposed luminance
    length: Pixels  # (H, W): number of frames in the mean
    depth: Pixels  # (H, W), infinite for a miss
    beside: Pixels  # (H, W, 2): px, from the centre of the pixel to the place where the surface had that light
    slope: Pixels  # (H, W): of the logarithm of the denoised light, per px
    exposure: np.float32  # of the sequence's first frame, in whose scale logarithms are compared; NaN for a black one


def accumulate(color: Pixels, surface: Surface, history: History | None, longest: float) -> tuple[Pixels, History]:
    """Add a noisy frame to the history that has not changed, and return the mean light and the history.

    color (H, W, 3): linear radiance. longest: the mean goes over this many frames at most. Without motion, or anything
    that tells where a surface was hidden, the frame stays as it is. The history has no slopes yet: see `with_slope`.
    Costs a fetch of seven components and about fifty operations a pixel, in one thread.
    """
    texture = _texture(color, surface.albedo)
    light = color / texture
    depth = np.full(color.shape[:2], np.inf, np.float32)
    if surface.depth is not None:
        depth = np.where(surface.depth[..., 0] > 0, surface.depth[..., 0], depth)
    if history is None or np.isnan(history.exposure):
        exposure = known_exposure(color.transpose(2, 0, 1)[None])[0]
        log = _log(light, exposure)
        nowhere = np.zeros((*log.shape, 2), np.float32)
        return color, History(light, log, np.ones_like(log), depth, nowhere, np.zeros_like(log), exposure)
    log = _log(light, history.exposure)
    found = _fetch(history, surface, depth)
    length = np.where(found.valid, (found.length * _kept(log, found) + 1).clip(1, longest), 1)
    share = 1 / length
    log = np.where(found.valid, found.log + (log - found.log) * share, log)
    share, valid = share[..., None], found.valid[..., None]
    light = np.where(valid, found.light + (light - found.light) * share, light)
    beside = np.where(valid, found.beside * (1 - share), 0)
    return light * texture, History(light, log, length, depth, beside, np.zeros_like(log), history.exposure)


def with_slope(history: History, denoised: Pixels, surface: Surface) -> History:
    """Put the slopes of the denoised frame (H, W, 3) into the history that it leaves."""
    log: Pixels = np.pad(_log(denoised / _texture(denoised, surface.albedo), history.exposure), 1, mode="edge")
    inner = log[1:-1, 1:-1]
    across = np.maximum(abs(log[1:-1, 2:] - inner), abs(log[1:-1, :-2] - inner))
    down = np.maximum(abs(log[2:, 1:-1] - inner), abs(log[:-2, 1:-1] - inner))
    return history._replace(slope=np.sqrt(across * across + down * down))


def _texture(color: Pixels, albedo: Pixels | None) -> Pixels:
    """What light is divided by: 1 where the albedo is black, as on emitters and on metals of some renderers."""
    if albedo is None:
        return np.ones_like(color)
    return np.where(albedo.any(-1, keepdims=True), albedo + FLOOR, 1 + FLOOR)


def _log(light: Pixels, exposure: np.float32) -> Pixels:
    return np.log1p(light @ (REC709 * exposure))


class _Found(NamedTuple):
    """A history on the pixels of this frame: images (H, W), or (H, W, 3) for light."""

    light: Pixels
    log: Pixels
    length: Pixels
    beside: Pixels  # (H, W, 2) px: from where it should be to where it is
    valid: Mask  # it is of the same surface
    error: Pixels  # expected, of the logarithm, as it was fetched from the nearest pixel


def _fetch(history: History, surface: Surface, depth: Pixels) -> _Found:
    """Fetch a history along the motion, from the nearest pixels. depth (H, W): infinite for a miss."""
    height, width = depth.shape
    motion = np.full((height, width, 2), np.nan, np.float32) if surface.motion is None else surface.motion
    finite = np.asarray(np.isfinite(motion).all(-1))
    place = np.where(finite[..., None], motion, 0) + _centres(height, width)
    size = np.array([width, height], np.float32)
    inside = finite & (place >= 0).all(-1) & (place < size).all(-1)
    # The light in a pixel lies beside its centre, if it was fetched with a fraction of a pixel before: without that
    # a slow motion would never move it.
    beside = history.beside.reshape(-1, 2).take(_index(place, size), 0)
    index = _index(place - beside, size)
    planes = [history.light, history.beside]
    planes += [plane[..., None] for plane in (history.log, history.length, history.slope)]
    planes += [history.depth[..., None]] if surface.depth is not None else []
    planes += [surface.forward] if surface.forward is not None else []
    fetched = np.concatenate(planes, -1).reshape(height * width, -1).take(index, 0)
    log, length, slope = np.moveaxis(fetched[..., 5:8], -1, 0)
    valid = inside & _seen(surface, motion, depth, fetched[..., 8:])
    beside = _centres(height, width).reshape(-1, 2).take(index, 0) + fetched[..., 3:5] - place
    error = slope * np.sqrt((beside * beside).sum(-1))
    return _Found(fetched[..., :3], log, length, beside, valid, error)


def _index(place: Pixels, size: Pixels) -> npt.NDArray[np.int32]:
    """The row-major index (H, W) of the pixel that contains each place (H, W, 2), or of the nearest at the border."""
    pixel = np.floor(place).clip(0, size - 1)
    return np.asarray(pixel[..., 1] * size[0] + pixel[..., 0], np.int32)


@lru_cache(maxsize=4)
def _centres(height: int, width: int) -> Pixels:
    """The centres (H, W, 2) of pixels, x and y."""
    rows, columns = np.mgrid[:height, :width]
    return np.asarray(np.stack([columns, rows], -1) + 0.5, np.float32)


def _seen(surface: Surface, motion: Pixels, depth: Pixels, fetched: Pixels) -> Mask:
    """Where a surface was seen in the previous frame: nothing that moved otherwise, or was nearer, hid it (H, W).

    fetched: what there is of (previous depth, forward motion) at the place where the surface was. The forward motion
    decides where it is known, as in `nte.dual_motion`, and the depth elsewhere; without both nothing was seen.
    """
    before = fetched[..., 0] if surface.depth is not None else depth
    hidden = before * BEHIND < depth
    if surface.forward is not None:
        forward = fetched[..., -2:]
        apart = ((motion + forward) ** 2).sum(-1) > HIDDEN_PX**2
        hidden = np.where(np.isfinite(forward).all(-1), apart & ~(before > BEHIND * depth), hidden)
    elif surface.depth is None:
        hidden = np.ones_like(depth, bool)
    return np.asarray(~hidden, np.bool_)


def _kept(log: Pixels, found: _Found) -> Pixels:
    """The share (H, W) of a history that is kept beside a frame, by their logarithms of luminance."""
    height, width = log.shape
    change = np.where(found.valid, log - found.log, 0)
    error = np.where(found.valid, found.error, 0)
    sums = _block_sums(np.stack([change, change * change, error * error, found.valid.astype(np.float32)], -1))
    kept = np.ones(sums.shape[:2], np.float32)
    for deviation in (NEAR, FAR):
        mean, square, _, count = np.moveaxis(_blurred(sums, deviation), -1, 0)
        count = np.maximum(count, 1e-3)
        mean, square = mean / count, square / count
        of_mean = np.maximum(square - mean * mean, 1e-6) / (count * _pixels(deviation))
        kept = np.minimum(kept, DOUBT / (DOUBT + mean * mean / of_mean))
    _, square, slopes, count = np.moveaxis(_blurred(sums, NOISE), -1, 0)
    slopes = SLOPE * slopes
    noise = np.maximum(square - slopes, 1e-6 * count)
    kept, noise, slopes = (_upsampled(plane, height, width) for plane in (kept, noise, slopes))
    noise = noise * found.length / (found.length + 1)  # of one frame: the change has that of the history as well
    return np.asarray(kept * noise / (noise + slopes * found.length + 1e-12), np.float32)


def _block_sums(planes: Pixels) -> Pixels:
    """Sums over blocks of (H, W, C), divided by the pixels of a block."""
    height, width, count = planes.shape
    padded = np.pad(planes, [(0, -height % BLOCK), (0, -width % BLOCK), (0, 0)])
    rows = padded.reshape(-1, BLOCK, padded.shape[1], count).sum(1)
    return np.asarray(rows.reshape(len(rows), -1, BLOCK, count).sum(2) / BLOCK**2, np.float32)


def _pixels(deviation: float) -> float:
    """Number of pixels over which a Gaussian of this standard deviation, in px, averages."""
    return 4 * np.pi * deviation**2


def _blurred(blocks: Pixels, deviation: float) -> Pixels:
    """Blur images of blocks (H, W, C) so that, with the block itself, it is a Gaussian; nothing is outside."""
    own = (BLOCK**2 - 1) / 12  # variance of a block
    rows, columns = (_gaussian(size, ((deviation**2 - own) ** 0.5) / BLOCK) for size in blocks.shape[:2])
    down = np.tensordot(rows, blocks, 1)  # (H, W, C)
    return np.asarray(np.tensordot(columns, down, (1, 1)).transpose(1, 0, 2), np.float32)


@lru_cache(maxsize=16)
def _gaussian(size: int, deviation: float) -> Pixels:
    """A matrix (size, size) that blurs; its rows sum to 1 within the image, as weights beyond its end count as 0."""
    at = np.arange(size, dtype=np.float32)
    weights = np.exp(-0.5 * ((at[:, None] - at) / deviation) ** 2)
    whole = np.exp(-0.5 * (np.arange(-int(5 * deviation) - 5, int(5 * deviation) + 6) / deviation) ** 2).sum()
    return np.asarray(weights / whole, np.float32)


def _upsampled(blocks: Pixels, height: int, width: int) -> Pixels:
    """Interpolate an image of blocks linearly at pixels."""
    rows, columns = _interpolation(height, blocks.shape[0]), _interpolation(width, blocks.shape[1])
    return np.asarray(rows @ blocks @ columns.T, np.float32)


@lru_cache(maxsize=16)
def _interpolation(size: int, blocks: int) -> Pixels:
    """A matrix (size, blocks) that interpolates linearly between the centres of blocks."""
    place = ((np.arange(size) + 0.5) / BLOCK - 0.5).clip(0, blocks - 1)
    return np.asarray(np.maximum(0, 1 - abs(place[:, None] - np.arange(blocks))), np.float32)
