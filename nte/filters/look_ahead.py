"""The light of the next frame, added to what a frame has accumulated, for who can wait for it.

Behind what moves lies a surface that the past has not seen, and the next frame has; and twice as much light has half
the noise. The next frame is judged as the past is (nte.filters.accumulation), along the forward motion. Then both lose
weight where they differ from each other, as on both sides of an edge of a shadow that moves. More than one frame ahead
adds nothing: as few histories are longer. What was measured is in docs/experiments.md.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from nte.filters.accumulation import History, Surface, accumulate, begin, logarithm, texture_of
from nte.filters.change import significance, statistics, upsampled
from nte.frames.clip import Pixels

DOUBT = 6.0  # significance of a difference between past and next frame at which both lose half of their weight
WITNESS = 0.1  # weight of the next frame, of this one's, from which on such a difference counts in full


class Next(NamedTuple):
    """What is known of the next frame: images (C, H, W), or None."""

    color: Pixels  # (3, H, W): its noisy light
    albedo: Pixels | None
    depth: Pixels | None
    motion: Pixels | None  # (2, H, W) px, on it, to this frame; NaN = unknown
    forward: Pixels  # (2, H, W) px, from this frame to it; NaN = unknown


def add_next(
    color: Pixels,
    surface: Surface,
    history: History,
    after: Next,
    denoise_blocks: Callable[[Pixels], Pixels],
) -> Pixels:
    """Return the mean light (3, H, W) of a noisy frame, of its past and of the next frame, where neither has changed.

    color, surface, denoise_blocks: as `accumulate` takes them. history: what it has returned for the frame, which stays
    as it is, since the next frame has a turn of its own. Costs what `accumulate` does, and twice its memory.
    """
    exposure, texture = history.exposure, texture_of(color, surface.albedo)
    light = color / texture
    alone = begin(after.color / texture_of(after.color, after.albedo), after.depth, exposure)
    alone = alone._replace(slope=history.slope)
    back = Surface(surface.albedo, after.forward, surface.depth, after.motion)
    _, future = accumulate(color, back, alone, 2, denoise_blocks)
    if future.exposure != exposure:  # there is no next frame, for its light does not suit
        return history.light * texture
    log = logarithm(light, exposure)
    past, length = history.light * history.length - light, history.length - 1
    coming, count = future.light * future.length - light, future.length - 1
    both = (length > 0) & (count > 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        change = (history.log * history.length - log) / length - (future.log * future.length - log) / count
    found = statistics(np.where(both, change, 0), np.zeros_like(length), light, both)
    blocks = DOUBT / (DOUBT + significance(found))
    blocks = np.pad(blocks[None], [(0, 0), (1, 1), (1, 1)], mode="edge")
    kept = upsampled(blocks)[0, : length.shape[0], : length.shape[1]]
    # A next frame of which nothing is taken, as where a lamp is switched on, says nothing against the past.
    of_past = 1 - (1 - kept) * np.minimum(count / WITNESS, 1)
    length, past = length * of_past, past * of_past
    count, coming = count * kept, coming * kept
    mean = (light + past + coming) / (1 + length + count)
    return np.asarray(np.maximum(mean, 0) * texture, np.float32)
