"""Step 2, the pre-filter (section 4.2): samples from along a pixel's path, as if more than one had been traced."""

import torch
from torch import Tensor

from nte.filters.motion_blur.samples import COLOR, MOTION, MOVING, TIME, PixelList, gather, in_chunks, square
from nte.filters.motion_blur.weight import segment_distance
from nte.filters.noise import uniform_noise

SLOWEST = 3.0  # px over the open shutter: pixels that move less are left as they are
DRAWN = 2  # samples that each pixel draws, and shares with its 3×3 neighbours


def prefilter(rows: Tensor, pixels: PixelList, frame: int, near: float, jitter: float) -> Tensor:
    """Replace the colour of fast pixels, in the rows of samples, by the mean of up to 1 + 18 samples.

    frame: number of the frame, which seeds the random draws. near: distance in px, from the pixel to a sample's path,
    within which the sample counts. jitter: px, to both sides, by which drawn positions vary.
    """
    length = rows[pixels.index, MOTION].square().sum(1).sqrt()
    fast = pixels.some(length >= SLOWEST)
    if not len(fast.index):
        return rows
    _, height, width = fast.size
    noise = uniform_noise(height, width, frame, 3 * DRAWN, rows.device)[0].flatten(1).T
    rows = rows.clone()
    rows[fast.index, COLOR] = in_chunks(fast, 9 * DRAWN, lambda some, _: _collect(rows, some, noise, near, jitter))
    return rows


def _collect(rows: Tensor, pixels: PixelList, noise: Tensor, near: float, jitter: float) -> Tensor:
    """The colours (K, 3): means of each pixel and of the samples that its 3×3 neighbours drew and that pass near it."""
    around, places, inside = gather(rows, pixels, square(1, rows.device))
    drew = inside & (around[..., MOTION].square().sum(-1) >= SLOWEST**2)
    whole = places.floor().long()
    width = pixels.size.width
    number = (whole[..., 1] * width + whole[..., 0]).clamp(0, len(noise) - 1)
    random = noise[number].view(*number.shape, DRAWN, 3)  # (K, 9, 2, 3): t′ and j
    # s = p + v_p (t′ − t_p) + j
    way = around[..., None, MOTION] * (random[..., :1] - around[..., None, TIME, None])
    drawn = places[..., None, :] + way + (2 * random[..., 1:] - 1) * jitter
    drawn, drew = drawn.flatten(1, 2), drew.repeat_interleave(DRAWN, 1)
    own = torch.stack([pixels.x, pixels.y], 1)[:, None]
    found, at, within = gather(rows, pixels, drawn.floor().long() - own)
    close = segment_distance(pixels.centres(), at, found[..., MOTION], found[..., TIME]) < near
    kept = (drew & within & close & (found[..., MOVING] > 0)).float()[..., None]
    total = rows[pixels.index, COLOR] + (kept * found[..., COLOR]).sum(1)
    return total / (1 + kept.sum(1))
