"""Merging a burst: every frame aligned to a reference, and averaged where it shows the same within the noise.

Hanika, Tessari and Dachsbacher 2021, «Fast Temporal Reprojection without Motion Vectors», section 4.2: mosaics are
aligned as grey images of one value per sensor block and merged before demosaicing. The weights are ours.
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

# Windows over which differences are compared with the noise, and how many deviations of their mean count as noise.
# A large one sees faint differences; a small one sees thin things that a large one would dilute.
WINDOWS = ((7, 1.0), (3, 3.0))
_SUBSTITUTE = 0.1  # weight of what stands in for a defect of the reference: any other frame knows better
_WHITE = 1 - 1e-4  # from here on a sensor is saturated, whatever 16 bits make of its white level
RADII = (16, 8, 4, 2)  # of the search's patches: the gains of (10, 4, 2, 2) and (8, 8, 4, 4) are the same or lower


@dataclass(frozen=True)
class Aligned:
    """What became of one frame."""

    motion: tuple[float, float]  # median, in pixels of the sensor: reference → this frame
    share: float  # mean weight, relative to the reference's own pixel: 1 where everything fits


class Merged(NamedTuple):
    """The merged picture."""

    image: Tensor  # as the reference: mosaic (1, 1, H, W) or image (1, C, H, W)
    weight: Tensor  # (1, 1, H, W): of how many frames each pixel is the mean, from 1 on (defects: from 0.1)
    frames: list[Aligned]  # of the others, in their order


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
    """Mean of `reference` and of what fits in `others`, linear values of white level 1, each (1, C, H, W).

    With a mosaic C is 1 and frames are fetched by whole pixels of the same colour; without one they are images
    of at least one channel, fetched bilinearly. A frame's pixel with an excess difference b is weighted by the
    inverse of its squared error, 1 / (1 + b²/σ²): at most half a deviation of a single frame's b remains.
    radii: of the search's patches, finest first, in blocks of the sensor or pixels. reach: told after each frame.
    clips: whether values end at 1: what the reference shows saturated stays, since a mean with what other frames'
    noise brought below would be darker. defects (1, 1, H, W), bool: pixels of the sensor, in every frame, that tell
    nothing (`find_defects`). The frames are taken one by one. Raises NteError for frames of another size.
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
    """Motion (1, 2, H, W), current → previous, of grey images (1, 1, H, W): of the whole image, and then locally.

    A hand moves the whole picture, by more than what it shows is large: the search alone takes one leaf for
    another there.
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
    """(1, 1, H, W): variance that bilinear fetching leaves of independent noise, from ¼ between pixels to 1 on them."""
    part = (motion - motion.floor()).square() + (1 - motion + motion.floor()).square()
    return part[:, :1] * part[:, 1:]


def _weight(reference: Tensor, fetched: Tensor, mixed: Tensor, noise: NoiseModel) -> Tensor:
    """(1, 1, H, W) in [0, 1]: 1 where the difference is noise, else 1/(1 + b²/σ²) of its excess b².

    The squared difference has the mean σ²(1 + mixed) + b². Both are averaged over windows before they are
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
    """Means over size×size pixels; at the border over those that exist."""
    return F.avg_pool2d(values, size, 1, size // 2, count_include_pad=False)
