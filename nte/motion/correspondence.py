"""Where each pixel was in the previous image, found in the images alone: a hierarchical patch search.

Hanika, Tessari and Dachsbacher 2021, «Fast Temporal Reprojection without Motion Vectors», section 3. It aligns
colours and does not claim true motion: shadows, reflections, waves and clouds move in ways that no geometry tells.
"""

import warnings
from dataclasses import dataclass
from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor

from nte.errors import NteError
from nte.motion.agreement import agree
from nte.motion.box import box_mean
from nte.motion.patch_distance import NORMS, Norm, best_shift
from nte.motion.warp import warp

SCALE = 4  # from one level to the next, along each axis
_SMALLEST = 4  # px: a smaller level would search beyond the image only
# Patch radius per level, finest first, by the noise of the images (section 3.3)
RADII = {"clean": (2, 2, 2, 2), "noisy": (10, 4, 2, 2), "strong": (32, 16, 8, 8)}
# Ours: with values in [0, 1] as they are, the centre's weight outweighs any edge of the image. Chosen on the train
# clips of datasets/correspondence.yaml, as are SEARCHES.
GAIN = 30.0


class FewerLevelsWarning(UserWarning):
    """The images are too small for the whole pyramid, so long motions are out of reach."""


@dataclass(frozen=True)
class Search:
    """How to search.

    radii: of the patches, finest level first; as many levels as radii, each four times smaller: four reach
    170 px. norm: `l2`, `l1`, `log` (of 2 + L1) or `log_centred` (which prefers short shifts). gain: values are
    multiplied by it first for the log norms, which compare them with 2. smoothing: radius of the box over which
    the motion is averaged, finest level first (none beyond the last that is given). refined: on how many of the
    finest levels a fraction of a pixel is added. agreement: how strongly neighbouring motions are then made to
    agree (`nte.motion.agreement`), likewise; 0: not at all. half: search in images of half the size. error_level: of
    which level the patch distance is given, 0 the finest; 1 is steadier under much noise.
    """

    radii: tuple[int, ...] = RADII["clean"]
    norm: Norm = "log_centred"
    gain: float = GAIN
    smoothing: tuple[int, ...] = ()
    refined: int = 2
    agreement: tuple[float, ...] = ()
    half: bool = False
    error_level: int = 0

    def __post_init__(self) -> None:
        if self.norm not in NORMS:
            raise NteError(f"norm is '{self.norm}', expected one of {', '.join(NORMS)}")
        if not self.radii or min(self.radii) < 0:
            raise NteError(f"radii are {self.radii}, expected one of at least 0 for each level, finest first")
        if min(self.smoothing + self.agreement, default=0) < 0:
            raise NteError(
                f"smoothing is {self.smoothing} and agreement {self.agreement}, expected at least 0 for each level"
            )
        if not 0 < self.gain < float("inf"):
            raise NteError(f"gain is {self.gain}, expected a positive number")
        if not 0 <= self.error_level < len(self.radii):
            raise NteError(f"error_level is {self.error_level}, expected a level from 0 to {len(self.radii) - 1}")


# By the noise of the images: none, that of some 4 to 50 samples per pixel, of 1, and worse. Smoothing and agreement
# are ours: with them smaller patches than the paper's are better.
SEARCHES = {
    "clean": Search(),
    "moderate": Search(smoothing=(2, 1, 1), agreement=(0, 4)),
    "noisy": Search((3, 3, 3, 2), smoothing=(3, 3, 2, 1), agreement=(8, 8), half=True, error_level=1),
    "strong": Search(RADII["strong"], smoothing=(8, 4, 2, 1), agreement=(8, 8), half=True, error_level=1),
}


class Known(NamedTuple):
    """Motion that need not be searched: (N, 2, H, W) in pixels, and the mask (N, 1, H, W), bool, where it holds."""

    motion: Tensor
    mask: Tensor


class Correspondence(NamedTuple):
    """What was found."""

    motion: Tensor  # (N, 2, H, W) pixels, current → previous: previous = current + motion; always finite
    error: Tensor  # (N, 1, H, W) patch distance in the units of the norm, 0 where the patches are equal


@torch.no_grad()
def find_correspondence(
    current: Tensor, previous: Tensor, search: Search | None = None, known: Known | None = None
) -> Correspondence:
    """Search every pixel of `current` in `previous`, both (N, C, H, W): grey, or noise-free guides as channels.

    Values should be about as large as displayed ones, [0, 1]: the log norms compare them with 2. What is not
    finite counts as 0; at the border the previous image is clamped. `known` motion overwrites what is found on
    every level, and so guides the search around it. Small images get fewer levels (FewerLevelsWarning). The
    same input gives the same output. Takes half as long as OpenCV's Farnebäck in images of half the size, and up to
    2.5 times as long in full ones (docs/correspondence.md); no gradients.
    Raises NteError for images that differ in size.
    """
    search = search or Search()
    if current.shape != previous.shape or current.ndim != 4:
        raise NteError(
            f"current {tuple(current.shape)} and previous {tuple(previous.shape)}: expected two images (N, C, H, W) "
            "of one size"
        )
    scale = search.gain if search.norm.startswith("log") else 1.0
    current, previous = (torch.nan_to_num(image.float(), 0, 0, 0) * scale for image in (current, previous))
    if search.half and min(current.shape[-2:]) >= 2 * _SMALLEST:
        now, before, fixed = _smaller(current, 2), _smaller(previous, 2), known and _smaller_known(known, 2)
        motion, error = _search(now, before, fixed, search)
        motion, error = _upsample(motion, current, 2) * 2, _upsample(error, current, 2)
        return Correspondence(motion if known is None else torch.where(known.mask, known.motion, motion), error)
    return Correspondence(*_search(current, previous, known, search))


class BothWays(NamedTuple):
    """Correspondences of two images in both directions, and where they agree."""

    backward: Correspondence  # current → previous
    forward: Correspondence  # previous → current, on the pixels of the previous image
    consistent: Tensor  # (N, 1, H, W) bool, on the current pixels


@torch.no_grad()
def find_both_ways(
    current: Tensor, previous: Tensor, search: Search | None = None, tolerance: float = 1.0
) -> BothWays:
    """`find_correspondence` backward and forward; consistent: there and back ends within `tolerance` pixels.

    What came into sight has no correspondence, and usually fails this.
    """
    backward = find_correspondence(current, previous, search)
    forward = find_correspondence(previous, current, search)
    there = warp(forward.motion, backward.motion)
    apart = (backward.motion + there.image).square().sum(1, keepdim=True).sqrt()
    return BothWays(backward, forward, there.valid & (apart <= tolerance))


def rejection_mask(error: Tensor, kappa: float, eta: float) -> Tensor:
    """m = κ ε − η (section 3.2) of the patch distance ε (N, 1, H, W), clamped to [0, 1]: 1 where not to be trusted.

    Without the clamp a small ε would make the weight of history exceed the one that was chosen.
    """
    return (kappa * error - eta).clamp(0, 1)


def _search(
    current: Tensor, previous: Tensor, known: Known | None, search: Search
) -> tuple[Tensor, Tensor]:
    """Motion and patch distance, level by level from the coarsest."""
    levels = _pyramid(current, previous, known, len(search.radii))
    error_level = min(search.error_level, len(levels) - 1)
    motion: Tensor | None = None
    error = current
    for level in reversed(range(len(levels))):
        motion, distance = _search_level(levels[level], motion, search, level)
        if level == error_level:
            error = distance
    assert motion is not None
    return motion, _upsample(error, levels[0][0], SCALE**error_level) if error_level else error


def _search_level(
    images: tuple[Tensor, Tensor, Known | None], coarser: Tensor | None, search: Search, level: int
) -> tuple[Tensor, Tensor]:
    """Motion and patch distance of a level, around the motion of the coarser one."""
    now, before, known = images
    if coarser is None:
        motion, distance = best_shift(now, before, search.radii[level], search.norm, level < search.refined)
    else:
        motion = _upsample(coarser, now, SCALE) * SCALE
        warped = warp(before, motion).image
        shift, distance = best_shift(now, warped, search.radii[level], search.norm, level < search.refined)
        # What was compared lies at x + shift in the warped image, which shows the previous one from there on.
        motion = shift + warp(motion, shift).image
        del warped, shift  # a sixth of the search's memory
    if radius := dict(enumerate(search.smoothing)).get(level, 0):
        motion = box_mean(motion, 2 * radius + 1)
    if strength := dict(enumerate(search.agreement)).get(level, 0.0):
        # The log norms' values are scaled already.
        gain = 1.0 if search.norm.startswith("log") else search.gain
        motion = agree(now, before, motion, strength, gain)
    if known is not None:
        motion = torch.where(known.mask, known.motion, motion)
    return motion, distance


def _pyramid(
    current: Tensor, previous: Tensor, known: Known | None, wanted: int
) -> list[tuple[Tensor, Tensor, Known | None]]:
    """The images and known vectors of all levels, finest first; fewer than wanted if the images are small."""
    levels = [(current, previous, known)]
    while len(levels) < wanted and min(current.shape[-2:]) >= SCALE * _SMALLEST:
        current, previous = _smaller(current, SCALE), _smaller(previous, SCALE)
        known = known and _smaller_known(known, SCALE)
        levels.append((current, previous, known))
    if len(levels) < wanted:
        height, width = levels[0][0].shape[-2:]
        warnings.warn(
            f"{width}x{height} pixels are too few for {wanted} levels: the search uses {len(levels)} and "
            f"reaches {sum(2 * SCALE**level for level in range(len(levels)))} pixels",
            FewerLevelsWarning,
            stacklevel=5,
        )
    return levels


def _smaller(image: Tensor, scale: int) -> Tensor:
    """Means over scale×scale pixels; at the right and bottom border over those that exist."""
    return F.avg_pool2d(image, scale, ceil_mode=True, count_include_pad=False)


def _smaller_known(known: Known, scale: int) -> Known:
    """Mean of the known vectors of each block, in the smaller image's pixels, where at least half of it is known."""
    share = _smaller(known.mask.float(), scale)
    total = _smaller(torch.where(known.mask, known.motion, 0.0), scale)
    return Known(total / (share.clamp(min=1e-6) * scale), share >= 0.5)


def _upsample(values: Tensor, like: Tensor, scale: int) -> Tensor:
    """Bilinear, pixel centre to pixel centre, cropped to the size of `like`."""
    height, width = like.shape[-2:]
    large = F.interpolate(values, scale_factor=scale, mode="bilinear", align_corners=False)
    return large[..., :height, :width]
