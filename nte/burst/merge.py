"""The merge of a burst: every frame is aligned to a reference, and averaged where it agrees within the noise.

Source: Hanika, Tessari and Dachsbacher 2021, «Fast Temporal Reprojection without Motion Vectors», section 4.2: mosaics
are aligned as grey images of one value per sensor block and merged before demosaicing. The weights are nte's own.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor

from nte.burst.defects import mend
from nte.burst.mosaic import Mosaic
from nte.burst.noise import NoiseModel
from nte.errors import NteError
from nte.motion.correspondence import Search, find_correspondence
from nte.motion.warp import warp
from nte.motion.whole_shift import whole_shift

# Sides of the windows over which differences are compared with the noise, and the deviations of their mean that still
# count as noise. A large window sees faint differences; a small one sees thin things that a large one would dilute.
WINDOWS = ((7, 1.0), (3, 3.0))
_SUBSTITUTE = 0.1  # weight of a filled defect of the reference, low since any other frame knows better
_PART = 1e-3  # of a pixel fetched between others: a defect's share from here on counts; rounding makes smaller ones
_WHITE = 1 - 1e-4  # a sensor value from here on is saturated; the margin allows for rounding to 16 bits
RADII = (16, 8, 4, 2)  # radii of the search's patches; (10, 4, 2, 2) and (8, 8, 4, 4) gain the same or less


@dataclass(frozen=True)
class Aligned:
    """The alignment of one frame, and its weight in the merge."""

    motion: tuple[float, float]  # median, in pixels of the sensor: reference → this frame
    share: float  # mean weight, relative to the reference's own pixel: 1 where everything fits


class Merged(NamedTuple):
    """The merged picture, with the weight of each pixel and the alignment of each frame."""

    image: Tensor  # of the reference's kind: mosaic (1, 1, H, W) or image (1, C, H, W)
    weight: Tensor  # (1, 1, H, W): number of frames that each pixel averages, at least 1 (defects: at least 0.1)
    frames: list[Aligned]  # one for each other frame, in order


@torch.no_grad()
def merge_burst(
    reference: Tensor,
    others: Iterable[Tensor],
    noise: NoiseModel,
    mosaic: Mosaic | None = None,
    radii: tuple[int, ...] = RADII,
    reach: Callable[[int], object] = lambda done: None,
    clips: bool = True,
    defects: Tensor | None = None,
) -> Merged:
    """Average `reference` and the pixels of `others` that agree with it; linear values, white level 1, (1, C, H, W).

    With a mosaic C is 1, and frames are fetched by whole pixels of the same colour; without one they are images of at
    least one channel, fetched bilinearly. A frame's pixel with an excess difference b is weighted by the inverse of its
    squared error, 1 / (1 + b²/σ²): at most half a deviation of a single frame's b remains. radii: patch radii of the
    search, finest level first, in blocks of the sensor or in pixels. reach: called after each frame with the number of
    frames done. clips: true if values end at 1; saturated pixels of the reference then stay, since other frames' noise
    below 1 would darken them. defects: bool (1, 1, H, W), pixels of the sensor that are useless in every frame
    (`find_defects`). The frames are taken one by one. Raises NteError for frames of another size.
    """
    weights, found = torch.ones_like(reference[:, :1]), []
    if defects is not None:
        reference = mend(reference, defects, mosaic)
        weights = torch.where(defects, _SUBSTITUTE, weights)
    grey, total = _grey(reference, mosaic), weights * reference
    for number, frame in enumerate(others, 1):
        if frame.shape != reference.shape:
            raise NteError(f"frame {number} is {tuple(frame.shape)}, the reference {tuple(reference.shape)}")
        if defects is not None:
            frame = mend(frame, defects, mosaic)
        motion = find_motion(grey, _grey(frame, mosaic), radii)
        if mosaic is not None:
            motion = mosaic.spread(motion, *reference.shape[-2:])
            fetched, valid = mosaic.fetch(frame, motion)
            if defects is not None:
                valid = valid & ~mosaic.fetch(defects, motion)[0]
            mixed = torch.ones_like(weights)
        else:
            fetched, valid = warp(frame, motion)
            if defects is not None:
                valid = valid & (warp(defects.to(frame.dtype), motion).image < _PART)
            mixed = _mixed(motion)
        weight = _weight(reference, fetched, mixed, noise) * valid
        total += weight * fetched
        weights += weight
        x, y = (float(component) for component in motion[0].flatten(1).median(1).values)
        found.append(Aligned((x, y), float(weight.mean())))
        reach(number)
    image = total / weights
    return Merged(torch.where(reference >= _WHITE, reference, image) if clips else image, weights, found)


def find_motion(current: Tensor, previous: Tensor, radii: tuple[int, ...]) -> Tensor:
    """Find the motion (1, 2, H, W), in pixels, current → previous, of grey images (1, 1, H, W).

    The shift of the whole image is found first, then the local motion: a hand may move the picture by more than the
    size of its details, and a local search alone would take one leaf for another. radii: patch radii of the search,
    finest level first.
    """
    x, y = whole_shift(current, previous)
    height, width = current.shape[-2:]
    rows = (torch.arange(height, device=current.device) + y).clamp(0, height - 1)
    columns = (torch.arange(width, device=current.device) + x).clamp(0, width - 1)
    shifted = previous[..., rows, :][..., columns]
    motion = find_correspondence(current, shifted, Search(radii=radii, norm="l1")).motion
    return motion + motion.new_tensor([x, y]).view(1, 2, 1, 1)


def _grey(image: Tensor, mosaic: Mosaic | None) -> Tensor:
    return image.mean(1, keepdim=True) if mosaic is None else mosaic.bin(image)


def _mixed(motion: Tensor) -> Tensor:
    """Share of noise variance (1, 1, H, W) that bilinear fetching keeps, from ¼ between four pixels to 1 on a pixel."""
    part = (motion - motion.floor()).square() + (1 - motion + motion.floor()).square()
    return part[:, :1] * part[:, 1:]


def _weight(reference: Tensor, fetched: Tensor, mixed: Tensor, noise: NoiseModel) -> Tensor:
    """Weight (1, 1, H, W) in [0, 1]: 1 where the difference is noise, else 1/(1 + b²/σ²) with its excess b².

    The squared difference has the mean σ²(1 + mixed) + b². Both sides are averaged over windows before they are
    compared, so that a dark pixel's uncertain σ² does not matter.
    """
    difference = (reference - fetched).square().mean(1, keepdim=True)
    variance = noise.variance((reference + fetched) / 2).mean(1, keepdim=True)
    excess = torch.zeros_like(difference)
    for size, deviations in WINDOWS:
        expected = _window(variance * (1 + mixed), size)
        samples = size * size * reference.shape[1]
        beyond = _window(difference, size) - expected * (1 + deviations * (2 / samples) ** 0.5)
        excess = torch.maximum(excess, beyond.clamp(min=0) / _window(variance, size))
    return 1 / (1 + excess)


def _window(values: Tensor, size: int) -> Tensor:
    """Means over size×size pixels; at the border over the pixels that exist."""
    return F.avg_pool2d(values, size, 1, size // 2, count_include_pad=False)
