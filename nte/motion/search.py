"""Settings of the patch search, and the choice among them by the noise of the images."""

from dataclasses import dataclass

import torch
from torch import Tensor

from nte.errors import NteError, expected_one_of
from nte.motion.noise_level import noise_level
from nte.motion.patch_distance import NORMS, Norm

# The paper's patch radius per level, finest first, by the noise of the images (section 3.3)
RADII = {"clean": (2, 2, 2, 2), "noisy": (10, 4, 2, 2), "strong": (32, 16, 8, 8)}
# Not in the paper: for unscaled values in [0, 1], the centre's weight would outweigh any edge of the image. GAIN and
# SEARCHES were chosen on training clips.
GAIN = 30.0


@dataclass(frozen=True)
class Search:
    """Settings of the patch search.

    radii: of the patches, px, one per level, finest first; each level is four times smaller than the one below, and
    four levels reach 170 px. norm: `l2`, `l1`, `log` (logarithm of 2 + L1) or `log_centred` (the same, with a
    preference for short shifts). gain: factor for the values in the log norms, which compare them with 2. smoothing:
    radius of the box over which the motion is averaged, finest level first; levels without a value are not smoothed.
    refined: number of levels, from the finest, on which a fraction of a pixel is found. agreement: how strongly the
    motion is then brought into agreement with its neighbours (`nte.motion.agreement`), finest level first; 0 skips that
    step. half: search in images of half the size. error_level: the level of the patch error, 0 for the finest; 1 is
    steadier under strong noise. Raises NteError for values that make no search.
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
            raise NteError(f"norm is '{self.norm}'{expected_one_of(self.norm, NORMS)}")
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


# One per noise level of the images: none, about 4 to 50 samples per pixel, 1 sample, and worse. Smoothing and agreement
# are not in the paper; with them, smaller patches than the paper's are better. Chosen on training clips.
SEARCHES = {
    "clean": Search(smoothing=(2, 1, 1), agreement=(1, 1), half=True),
    "moderate": Search(smoothing=(2, 1, 1), agreement=(4, 4), error_level=1),
    "noisy": Search((3, 3, 3, 2), smoothing=(2, 2, 1, 1), agreement=(4, 4), half=True, error_level=1),
    "strong": Search(RADII["strong"], smoothing=(8, 4, 2, 1), agreement=(8, 8), half=True, error_level=1),
}
# The noise of displayed values in [0, 1] (`noise_level`) below which each search is chosen.
NOISE_LIMITS = {"clean": 0.02, "moderate": 0.04, "noisy": 0.25}


def noise_of(image: Tensor) -> str:
    """Name the search, a key of SEARCHES, for the noisiest of images (N, C, H, W) of displayed values."""
    finite = torch.nan_to_num(image.float(), 0, 0, 0)
    level = float(noise_level(finite).max()) if finite.numel() else 0.0
    return next((name for name, limit in NOISE_LIMITS.items() if level < limit), "strong")


def searches_for(images: Tensor) -> list[Search]:
    """Choose the search that suits the noise of each of the images (N, C, H, W) of displayed values."""
    return [SEARCHES[noise_of(image[None])] for image in images]
