"""Noisy light accumulated over time before a spatial denoiser, for as long as nothing says that it has changed.

A spatial denoiser takes all that it averages for one light. Light that lags behind, or a texture between two pixels,
stays in its image, while noise does not. So a pixel keeps as much of its history as the error of that history, seen
over a neighbourhood, does not stand out from the noise:

- light that has changed differs from its history in one direction all over a neighbourhood, in some colour;
- a surface is fetched from the nearest pixel, half a pixel off at most, which errs by its slope.

Nearest, not bilinear: a mean of neighbours has noise of another grain, which denoisers take for detail. What was
measured is in docs/experiments.md. Everything is NumPy, so that exported models can build on it without PyTorch.
"""

import math
import os
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from nte.frames.clip import Pixels
from nte.frames.scalars import known_exposure

Mask = npt.NDArray[np.bool_]

BLOCK = 4  # px; changes are looked for in means over blocks of this size
STRIP = 64  # px; rows of an image that are worked on at once, a multiple of a block
NEAR, FAR = 3.0, 10.0  # px; standard deviations of the neighbourhoods in which they are looked for
NOISE = 2.0  # px; that of the neighbourhood whose noise is measured
DOUBT = 3.0  # significance (mean² / variance of the mean − 1) of a difference at which a half of the history goes
MOST = 30.0  # a frame so many times as bright as its history, or as dark, begins another one
SLOPE = 8.0  # weight of the squared error that half a pixel makes on a slope
FLOOR = 0.3  # added to the albedo before light is divided by it
# The rule for hidden surfaces of nte.motion.geometric, which is PyTorch's; a test holds the two together.
HIDDEN_PX, BEHIND = 0.5, 1.1


class Surface(NamedTuple):
    """What is known of a frame's surfaces: images (C, H, W), or None."""

    albedo: Pixels | None
    motion: Pixels | None  # (2, H, W) px, current → previous; NaN = unknown
    depth: Pixels | None  # (1, H, W), scene units, 0 = miss
    forward: Pixels | None  # (2, H, W) px, on the previous frame, to this one; NaN = unknown


class History(NamedTuple):
    """What a frame leaves to the next one."""

    light: Pixels  # (3, H, W): mean light, divided by the texture
    log: Pixels  # (3, H, W): mean logarithm of 1 + exposed light
    length: Pixels  # (H, W): number of frames in the mean
    depth: Pixels  # (H, W), infinite for a miss
    beside: Pixels  # (2, H, W): px, from the centre of the pixel to the place where the surface had that light
    slope: Pixels  # (H, W): of the logarithm of the denoised light, per px
    exposure: np.float32  # in whose scale logarithms are compared, of the first frame; NaN for a black one


def accumulate(color: Pixels, surface: Surface, history: History | None, longest: float) -> tuple[Pixels, History]:
    """Add a noisy frame to the history that has not changed, and return the mean light and the history.

    color (3, H, W): linear radiance. longest: the mean goes over this many frames at most. Without motion, or anything
    that tells where a surface was hidden, the frame stays as it is. The history has no slopes yet: see `with_slope`.
    Costs a fetch of eleven components and about fifty operations a pixel, in as many threads as OIDN takes.
    """
    texture = _texture(color, surface.albedo)
    light = color / texture
    depth = np.full(color.shape[1:], np.inf, np.float32)
    if surface.depth is not None:
        depth = np.where(surface.depth[0] > 0, surface.depth[0], depth)
    flat = np.zeros_like(depth)
    if history is None or surface.motion is None or not _comparable(log := _log(light, history.exposure), history.log):
        exposure = known_exposure(color[None])[0]
        return color, History(light, _log(light, exposure), flat + 1, depth, np.stack([flat, flat]), flat, exposure)
    old, length, beside = history, flat + 1, np.stack([flat, flat])

    def add(rows: slice, found: _Found, judged: Pixels) -> None:
        """Write the mean over the history and the frame over the frame, in these rows."""
        length[rows] = ((found.length * _kept(found, judged) + 1).clip(1, longest) - 1) * found.valid + 1
        share = (1 - 1 / length[rows]) * found.valid  # of the history
        for now, then in ((log[:, rows], found.log), (light[:, rows], found.light)):
            now += (then - now) * share
        np.multiply(found.beside, share, out=beside[:, rows])

    # In strips, which caches hold and threads share.
    strips = [slice(top, top + STRIP) for top in range(0, len(depth), STRIP)]
    with ThreadPoolExecutor(_threads()) as pool:
        found = list(pool.map(lambda rows: _fetch(old, surface, depth, rows), strips))
        sums = np.concatenate(list(pool.map(lambda rows, part: _sums(log[:, rows], part), strips, found)), 1)
        judged = np.pad(_judged(sums), [(0, 0), (1, 1), (1, 1)], mode="edge")
        of_strips = [judged[:, rows.start // BLOCK : rows.stop // BLOCK + 2] for rows in strips]
        list(pool.map(add, strips, found, of_strips))
    return light * texture, History(light, log, length, depth, beside, flat, history.exposure)


def _threads() -> int:
    """As many as OIDN has, which takes its turn afterwards."""
    return int(os.environ.get("OIDN_NUM_THREADS") or 0) or os.cpu_count() or 1


def with_slope(history: History, denoised: Pixels, surface: Surface) -> History:
    """Put the slopes of the denoised frame (3, H, W) into the history that it leaves."""
    light = (denoised / _texture(denoised, surface.albedo)).mean(0)
    log: Pixels = np.pad(_log(light, history.exposure), 1, mode="edge")
    inner = log[1:-1, 1:-1]
    across = np.maximum(abs(log[1:-1, 2:] - inner), abs(log[1:-1, :-2] - inner))
    down = np.maximum(abs(log[2:, 1:-1] - inner), abs(log[:-2, 1:-1] - inner))
    return history._replace(slope=np.sqrt(across * across + down * down))


def _texture(color: Pixels, albedo: Pixels | None) -> Pixels:
    """What light is divided by: no texture where the albedo is black, as on emitters and metals of some renderers."""
    if albedo is None:
        return np.ones_like(color)
    return np.where(albedo.any(0), albedo, 1) + np.float32(FLOOR)


def _comparable(log: Pixels, before: Pixels) -> bool:
    """Whether two logarithms of light are of a size, so that one exposure suits both; false for black, and for NaN."""
    now, then = float(log.mean()), float(before.mean())
    return now < MOST * then and then < MOST * now


def _log(light: Pixels, exposure: np.float32) -> Pixels:
    return np.asarray(np.log1p(light * exposure), np.float32)


class _Found(NamedTuple):
    """A history on the pixels of this frame: images (H, W), or (3, H, W) for light and its logarithm."""

    light: Pixels
    log: Pixels
    length: Pixels
    beside: Pixels  # (2, H, W) px: from where it should be to where it is
    valid: Mask  # nothing hid the surface, or the place is of what lies behind, as beside a silhouette
    error: Pixels  # expected, of the logarithm, as it was fetched from the nearest pixel


def _fetch(history: History, surface: Surface, depth: Pixels, rows: slice) -> _Found:
    """Fetch a history along the motion, from the nearest pixels, to these rows. depth (H, W): infinite for a miss."""
    height, width = depth.shape
    assert surface.motion is not None
    motion, depth = surface.motion[:, rows], depth[rows]
    finite = np.asarray(np.isfinite(motion).all(0))
    place = np.where(finite, motion, 0) + _centres(height, width)[:, rows]
    size = np.array([width, height], np.float32)[:, None, None]
    inside = finite & (place >= 0).all(0) & (place < size).all(0)
    if surface.albedo is not None:  # a screen or a mirror shows what its vectors know nothing of
        inside &= surface.albedo[:, rows].any(0)
    # The light in a pixel lies beside its centre, if it was fetched with a fraction of a pixel before: without that
    # a slow motion would never move it.
    index = _index(place - _taken(history.beside, _index(place, size)), size)
    beside = _taken(history.beside, index) + _taken(_centres(height, width), index) - place
    slope, log, length = (_taken(plane, index) for plane in (history.slope, history.log, history.length))
    before = None if surface.depth is None else _taken(history.depth, index)
    forward = None if surface.forward is None else _taken(surface.forward, index)
    valid = inside & _seen(motion, forward, depth, before)
    error = slope * np.sqrt((beside * beside).sum(0))
    return _Found(_taken(history.light, index), log, length, beside, valid, error)


def _index(place: Pixels, size: Pixels) -> npt.NDArray[np.int32]:
    """The row-major index (H, W) of the pixel that contains each place (2, H, W), or of the nearest at the border."""
    column, row = place.clip(0, size - 1).astype(np.int32)
    return np.asarray(row * np.int32(size[0].item()) + column, np.int32)


def _taken(image: Pixels, index: npt.NDArray[np.int32]) -> Pixels:
    """The pixels of an image (H, W) or (C, H, W) with these indices."""
    return image.reshape(*image.shape[:-2], -1).take(index, -1)


@lru_cache(maxsize=4)
def _centres(height: int, width: int) -> Pixels:
    """The centres (2, H, W) of pixels, x and y."""
    rows, columns = np.mgrid[:height, :width]
    return np.asarray(np.stack([columns, rows]) + 0.5, np.float32)


def _seen(motion: Pixels, forward: Pixels | None, depth: Pixels, before: Pixels | None) -> Mask:
    """Where a surface was seen in the previous frame: nothing that moved otherwise, or was nearer, hid it (H, W).

    forward (2, H, W), before (H, W): forward motion and depth at the place where the surface was in that frame. The
    forward motion decides where it is known, as in `nte.dual_motion`, and the depth elsewhere; without both nothing was
    seen.
    """
    if before is None:
        hidden, farther = np.full(depth.shape, forward is None), np.zeros(depth.shape, bool)
    else:
        hidden, farther = before * BEHIND < depth, before > BEHIND * depth
    if forward is not None:
        apart = ((motion + forward) ** 2).sum(0) > HIDDEN_PX**2
        hidden = np.where(np.isfinite(forward).all(0), apart & ~farther, hidden)
    return np.asarray(~hidden, np.bool_)


def _sums(log: Pixels, found: _Found) -> Pixels:
    """What tells a change from noise, as sums over blocks (8, ⌈H/4⌉, ⌈W/4⌉) divided by their pixels.

    The change of the logarithm in each colour, its squares, the squared error of a slope, and how many are valid.
    """
    height, width = found.length.shape
    planes = np.zeros((8, height + -height % BLOCK, width + -width % BLOCK), np.float32)
    change, squares, slopes, valid = (planes[i, :height, :width] for i in (slice(3), slice(3, 6), 6, 7))
    valid[:] = found.valid
    np.multiply(log - found.log, valid, out=change)  # np.where takes ten times as long
    np.multiply(change, change, out=squares)
    np.multiply(found.error * found.error, valid, out=slopes)
    rows = planes.reshape(8, -1, BLOCK, planes.shape[2]).sum(2)
    return np.asarray(sum(rows[..., i::BLOCK] for i in range(BLOCK)) / np.float32(BLOCK**2), np.float32)


def _judged(sums: Pixels) -> Pixels:
    """Judge blocks by their neighbourhoods (3, H/4, W/4): the share of the history that is kept, noise, and slopes."""
    kept = np.ones(sums.shape[1:], np.float32)
    for deviation in (NEAR, FAR):
        *sums_of_change, _, count = _blurred(sums, deviation)
        mean, square = np.stack(sums_of_change).reshape(2, 3, *count.shape) / np.maximum(count, 1e-3)
        of_mean = np.maximum(square - mean * mean, 1e-6) / (np.maximum(count, 1e-3) * _pixels(deviation))
        # Noise alone has 1 in the mean, in each colour.
        significance = np.maximum(mean * mean / of_mean - 1, 0).max(0)
        kept = np.minimum(kept, DOUBT / (DOUBT + significance))
    *_, slopes, count = blurred = _blurred(sums, NOISE)
    slopes = SLOPE * slopes
    noise = np.maximum(blurred[3:6].mean(0) - slopes, 1e-6 * count)
    return np.stack([kept, noise, slopes])


def _kept(found: _Found, judged: Pixels) -> Pixels:
    """The share (H, W) of a history that is kept beside a frame. judged: of its blocks and of those around them."""
    height, width = found.length.shape
    kept, noise, slopes = _upsampled(judged)[:, :height, :width]
    # The noise is that of the change, which has that of the frame and that of the history.
    return np.asarray(kept * noise / (noise + slopes * (found.length + 1) + 1e-12), np.float32)


def _pixels(deviation: float) -> float:
    """Number of pixels over which a Gaussian of this standard deviation, in px, averages."""
    return 4 * np.pi * deviation**2


def _blurred(blocks: Pixels, deviation: float) -> Pixels:
    """Blur images of blocks (C, H, W) so that, with the block itself, it is a Gaussian; nothing is outside."""
    own = (BLOCK**2 - 1) / 12  # variance of a block
    width = (deviation**2 - own) ** 0.5 / BLOCK
    reach = math.ceil(4 * width)
    weights = np.exp(-0.5 * (np.arange(-reach, reach + 1) / width) ** 2)
    weights = (weights / weights.sum()).astype(np.float32)
    # Not as products of matrices: the threads of NumPy's library for those wait busily, and take cores from OIDN.
    for _ in range(2):
        padded = np.pad(blocks, [(0, 0), (reach, reach), (0, 0)])
        blocks = sum(weight * padded[:, i : i + blocks.shape[1]] for i, weight in enumerate(weights)).swapaxes(1, 2)
    return blocks


def _upsampled(blocks: Pixels) -> Pixels:
    """Interpolate images of blocks (C, H, W) linearly at the pixels of all but those at the border."""
    places = (np.arange(BLOCK, dtype=np.float32) + 0.5) / BLOCK - 0.5  # of a block's pixels, from its centre
    for _ in range(2):
        before, inner, after = blocks[..., :-2], blocks[..., 1:-1], blocks[..., 2:]
        parts = [inner + abs(x) * ((after if x > 0 else before) - inner) for x in places]
        blocks = np.stack(parts, -1).reshape(*blocks.shape[:2], -1).swapaxes(1, 2)
    return blocks
