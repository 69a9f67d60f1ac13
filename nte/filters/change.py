"""Where light has changed: statistics of blocks that tell a change from noise.

Two kinds of evidence against a history, each seen over blocks and their neighbourhoods:

- light that has changed differs from it in one direction all over a neighbourhood, in some colour;
- a spatial denoiser's glance at the blocks of this frame alone differs from the last denoised image by more than what
  noise leaves in it. It sees what moves within a neighbourhood, such as the shadow of a slat.

Everything is NumPy. What was measured is in docs/experiments.md.
"""

import math

import numpy as np
import numpy.typing as npt

from nte.frames.clip import Pixels

BLOCK = 4  # px; changes are looked for in means over blocks of this size
SCALES = 1.2, 3.0, 10.0  # px; standard deviations of the neighbourhoods they are looked for in; the first is a block
NOISE = 2.0  # px; that of the neighbourhood whose noise is measured
DOUBT = 3.0  # significance (mean² / variance of the mean − 1) of a difference at which a half of the history goes
GLANCE = 0.1  # squared difference of the glance, relative to the noise of a pixel, at which a half of it goes,
ALIKE = 0.003  # and what it is allowed to differ where there is no noise
SLOPE = 8.0  # weight of the squared error that half a pixel makes on a slope


def in_blocks(image: Pixels) -> Pixels:
    """The means (C, ⌈H/4⌉, ⌈W/4⌉) of an image (C, H, W) over blocks; its border goes on in what it does not fill."""
    height, width = image.shape[1:]
    if height % BLOCK or width % BLOCK:
        image = np.pad(image, [(0, 0), (0, -height % BLOCK), (0, -width % BLOCK)], mode="edge")
    return _sums(image) / np.float32(BLOCK**2)


def _sums(planes: Pixels) -> Pixels:
    rows = planes.reshape(len(planes), -1, BLOCK, planes.shape[2]).sum(2)
    return np.asarray(sum(rows[..., i::BLOCK] for i in range(BLOCK)), np.float32)


def statistics(change: Pixels, error: Pixels, light: Pixels, valid: npt.NDArray[np.bool_]) -> Pixels:
    """What tells a change from noise, as sums over blocks (12, ⌈H/4⌉, ⌈W/4⌉) divided by their pixels.

    change (3, H, W): of the logarithm of light. error (H, W): that a slope makes. light (3, H, W): denoised before.
    Summed are the change in each colour, its squares, how many are valid, the squared error, the light before, and how
    many are not valid. What sticks out of the picture is neither.
    """
    height, width = valid.shape
    planes = np.zeros((12, height + -height % BLOCK, width + -width % BLOCK), np.float32)
    parts = slice(3), slice(3, 6), 6, 7, slice(8, 11), 11
    changes, squares, count, slopes, before, unknown = (planes[part, :height, :width] for part in parts)
    count[:] = valid
    np.multiply(change, count, out=changes)  # np.where takes ten times as long
    np.multiply(changes, changes, out=squares)
    np.multiply(error * error, count, out=slopes)
    np.multiply(light, count, out=before)
    np.subtract(1, count, out=unknown)
    return _sums(planes) / np.float32(BLOCK**2)


def judged(found: Pixels, glance: Pixels, exposure: np.float32) -> Pixels:
    """Judge blocks by their neighbourhoods (3, H/4, W/4): the share of the history that is kept, noise, and slopes.

    found: the statistics. glance (3, H/4, W/4): the light of this frame, denoised by itself.
    """
    kept = DOUBT / (DOUBT + significance(found))
    *squares, count, slopes = _blurred(found[3:8], NOISE)
    slopes = SLOPE * slopes
    noise = np.maximum(np.mean(squares, 0) - slopes, 1e-6 * count)
    allowed = GLANCE * noise / np.maximum(count, 1e-3) + ALIKE
    kept /= 1 + (_apart(found, glance, exposure) / allowed) ** 2
    return np.stack([kept, noise, slopes])


def significance(found: Pixels) -> Pixels:
    """How much a change stands out of the noise (H/4, W/4), in the neighbourhood and the colour where it does most.

    found: the statistics. It is mean² / variance of the mean − 1, and 0 where nothing is known.
    """
    most = np.zeros(found.shape[1:], np.float32)
    for deviation in SCALES:
        *sums, count = _blurred(found[:7], deviation)
        count = np.maximum(count, 1e-3)
        mean, square = np.stack(sums).reshape(2, 3, *count.shape) / count
        of_mean = np.maximum(square - mean * mean, 1e-6) / (count * _pixels(deviation))
        # Noise alone has 1 in the mean, in each colour.
        most = np.maximum(most, (mean * mean / of_mean - 1).max(0))
    return most


def _apart(found: Pixels, glance: Pixels, exposure: np.float32) -> Pixels:
    """The squared difference (H/4, W/4) of the glance and the light before, of logarithms, in the colour with most.

    Only of blocks that are known as a whole: in others the glance sees light of other surfaces, such as lamps, too.
    """
    *before, unknown = found[8:]
    count = found[6] * (unknown == 0)
    before = np.stack(before) / np.maximum(count, 1 / BLOCK**2)
    apart = np.square(np.log1p(glance * exposure) - np.log1p(before * exposure)).max(0)
    total, weight = _blurred(np.stack([count * apart, count]), SCALES[1])
    return np.asarray(total / np.maximum(weight, 1e-3), np.float32)


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


def upsampled(blocks: Pixels) -> Pixels:
    """Interpolate images of blocks (C, H, W) linearly at the pixels of all but those at the border."""
    places = (np.arange(BLOCK, dtype=np.float32) + 0.5) / BLOCK - 0.5  # of a block's pixels, from its centre
    for _ in range(2):
        before, inner, after = blocks[..., :-2], blocks[..., 1:-1], blocks[..., 2:]
        parts = [inner + abs(x) * ((after if x > 0 else before) - inner) for x in places]
        blocks = np.stack(parts, -1).reshape(*blocks.shape[:2], -1).swapaxes(1, 2)
    return blocks
