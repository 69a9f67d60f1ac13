"""Noisy light accumulated over time before a spatial denoiser, for as long as nothing says that it has changed.

A spatial denoiser takes all that it averages for one light. Light that lags behind, or a texture between two pixels,
stays in its image, while noise does not. So a pixel keeps as much of its history as the error of that history, seen
over a neighbourhood, does not stand out from the noise:

- light that has changed differs from it (nte.filters.change);
- a surface is fetched from the nearest pixel, half a pixel off at most, which errs by its slope.

Nearest, not bilinear: a mean of neighbours has noise of another grain, which denoisers take for detail. What was
measured is in docs/experiments.md. Everything is NumPy, so that exported models can build on it without PyTorch.
"""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from nte.filters.change import BLOCK, in_blocks, judged, statistics, upsampled
from nte.frames.clip import Pixels
from nte.frames.scalars import known_exposure

Mask = npt.NDArray[np.bool_]

STRIP = 64  # px; rows of an image that are worked on at once, a multiple of a block
MOST = 30.0  # a frame so many times as bright as the first of its history, or as dark, begins another one
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
    denoised: Pixels  # (3, H, W): light after the spatial denoiser, divided by the texture
    slope: Pixels  # (H, W): of its logarithm, per px; until `with_denoised` that of the frame before
    exposure: np.float32  # in whose scale logarithms are compared, of the first frame; NaN for a black one
    level: float  # mean logarithm of that frame


def accumulate(
    color: Pixels,
    surface: Surface,
    history: History | None,
    longest: float,
    denoise_blocks: Callable[[Pixels], Pixels],
) -> tuple[Pixels, History]:
    """Add a noisy frame to the history that has not changed, and return the mean light and the history.

    color (3, H, W): linear radiance. longest: the mean goes over this many frames at most. denoise_blocks: a quick
    spatial denoiser for means over blocks of the frame (3, ⌈H/4⌉, ⌈W/4⌉). Without motion, or anything that tells where
    a surface was hidden, the frame stays as it is. The history has no denoised light yet: see `with_denoised`.
    Costs a fetch of fourteen components and about sixty operations a pixel, in as many threads as OIDN takes, and the
    denoiser of blocks.
    """
    texture = texture_of(color, surface.albedo)
    light = color / texture
    if history is None or surface.motion is None or not _suits(history, log := logarithm(light, history.exposure)):
        return color, begin(light, surface.depth, known_exposure(color[None])[0])
    depth = _distance(surface.depth, light)
    flat = np.zeros_like(depth)
    old, length, slope, beside = history, flat + 1, flat.copy(), np.stack([flat, flat])
    texture_in_blocks = in_blocks(texture)
    glance = denoise_blocks(in_blocks(light) * texture_in_blocks) / texture_in_blocks

    def add(rows: slice, found: _Found, blocks: Pixels) -> None:
        """Write the mean over the history and the frame over the frame, in these rows."""
        length[rows] = ((found.length * _kept(found, blocks) + 1).clip(1, longest) - 1) * found.valid + 1
        share = (1 - 1 / length[rows]) * found.valid  # of the history
        for now, then in ((log[:, rows], found.log), (light[:, rows], found.light)):
            now += (then - now) * share
        np.multiply(found.beside, share, out=beside[:, rows])
        np.multiply(found.slope, found.valid, out=slope[rows])

    # In strips, which caches hold and threads share.
    strips = [slice(top, top + STRIP) for top in range(0, len(depth), STRIP)]
    with ThreadPoolExecutor(_threads()) as pool:
        found = list(pool.map(lambda rows: _fetch(old, surface, depth, rows), strips))
        sums = list(pool.map(lambda rows, part: _statistics(log[:, rows], part), strips, found))
        blocks = judged(np.concatenate(sums, 1), glance, old.exposure)
        blocks = np.pad(blocks, [(0, 0), (1, 1), (1, 1)], mode="edge")
        of_strips = [blocks[:, rows.start // BLOCK : rows.stop // BLOCK + 2] for rows in strips]
        list(pool.map(add, strips, found, of_strips))
    return light * texture, History(light, log, length, depth, beside, light, slope, history.exposure, history.level)


def begin(light: Pixels, depth: Pixels | None, exposure: np.float32) -> History:
    """The history that a frame leaves which has none.

    light (3, H, W): divided by its texture. depth (1, H, W): 0 = miss. exposure: in whose scale logarithms are
    compared.
    """
    distance = _distance(depth, light)
    flat, log = np.zeros_like(distance), logarithm(light, exposure)
    return History(light, log, flat + 1, distance, np.stack([flat, flat]), light, flat, exposure, float(log.mean()))


def _distance(depth: Pixels | None, light: Pixels) -> Pixels:
    """Depth (H, W), infinite for a miss, and everywhere where it is not known."""
    unknown = np.full(light.shape[1:], np.inf, np.float32)
    return unknown if depth is None else np.where(depth[0] > 0, depth[0], unknown)


def _threads() -> int:
    """As many as OIDN has, which takes its turn afterwards, and for which what is no number is not given."""
    given = os.environ.get("OIDN_NUM_THREADS", "").strip()
    return (int(given) if given.isdecimal() else 0) or os.cpu_count() or 1


def with_denoised(history: History, denoised: Pixels, surface: Surface) -> History:
    """Put the denoised frame (3, H, W) into the history that it leaves."""
    light = denoised / texture_of(denoised, surface.albedo)
    log: Pixels = np.pad(logarithm(light.mean(0), history.exposure), 1, mode="edge")
    inner = log[1:-1, 1:-1]
    across = np.maximum(abs(log[1:-1, 2:] - inner), abs(log[1:-1, :-2] - inner))
    down = np.maximum(abs(log[2:, 1:-1] - inner), abs(log[:-2, 1:-1] - inner))
    return history._replace(denoised=light, slope=np.sqrt(across * across + down * down))


def texture_of(color: Pixels, albedo: Pixels | None) -> Pixels:
    """What light is divided by: no texture where the albedo is black, as on emitters and metals of some renderers."""
    if albedo is None:
        return np.ones_like(color)
    return np.where(albedo.any(0), albedo, 1) + np.float32(FLOOR)


def _suits(history: History, log: Pixels) -> bool:
    """Whether the exposure of a history suits a frame of this logarithm; never if either is black.

    The first frame decides, not the last: light that fades slowly ends below all that can be told apart.
    """
    now, first = float(log.mean()), history.level
    return now < MOST * first and first < MOST * now


def logarithm(light: Pixels, exposure: np.float32) -> Pixels:
    return np.asarray(np.log1p(light * exposure), np.float32)


class _Found(NamedTuple):
    """A history on the pixels of this frame: images (H, W), or (3, H, W) for light and its logarithm."""

    light: Pixels
    log: Pixels
    denoised: Pixels  # (3, H, W)
    length: Pixels
    beside: Pixels  # (2, H, W) px: from where it should be to where it is
    valid: Mask  # nothing hid the surface, or the place is of what lies behind, as beside a silhouette
    slope: Pixels
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
    light, denoised = _taken(history.light, index), _taken(history.denoised, index)
    before = None if surface.depth is None else _taken(history.depth, index)
    forward = None if surface.forward is None else _taken(surface.forward, index)
    valid = inside & _seen(motion, forward, depth, before)
    error = slope * np.sqrt((beside * beside).sum(0))
    return _Found(light, log, denoised, length, beside, valid, slope, error)


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


def _statistics(log: Pixels, found: _Found) -> Pixels:
    return statistics(log - found.log, found.error, found.denoised, found.valid)


def _kept(found: _Found, blocks: Pixels) -> Pixels:
    """The share (H, W) of a history that is kept beside a frame. blocks: judged, with those around."""
    height, width = found.length.shape
    kept, noise, slopes = upsampled(blocks)[:, :height, :width]
    # The noise is that of the change, which has that of the frame and that of the history.
    return np.asarray(kept * noise / (noise + slopes * (found.length + 1) + 1e-12), np.float32)
