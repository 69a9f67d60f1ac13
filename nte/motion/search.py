"""How to search: patches, norm and refinement, and which of them suit images of how much noise."""

from dataclasses import dataclass

import torch
from torch import Tensor

from nte.errors import NteError
from nte.motion.noise_level import noise_level
from nte.motion.patch_distance import NORMS, Norm

# Patch radius per level, finest first, by the noise of the images (section 3.3)
RADII = {"clean": (2, 2, 2, 2), "noisy": (10, 4, 2, 2), "strong": (32, 16, 8, 8)}
# Ours: with values in [0, 1] as they are, the centre's weight outweighs any edge of the image. Chosen on the train
# clips of docs/correspondence.md, as are SEARCHES.
GAIN = 30.0


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
# are ours: with them smaller patches than the paper's are better. Chosen on train clips (docs/correspondence.md).
SEARCHES = {
    "clean": Search(smoothing=(2, 1, 1), agreement=(1, 1), half=True),
    "moderate": Search(smoothing=(2, 1, 1), agreement=(0, 4), error_level=1),
    "noisy": Search((3, 3, 3, 2), smoothing=(2, 2, 1, 1), agreement=(4, 4), half=True, error_level=1),
    "strong": Search(RADII["strong"], smoothing=(8, 4, 2, 1), agreement=(8, 8), half=True, error_level=1),
}
# The largest noise of displayed values in [0, 1] (`noise_level`) for which a search is chosen.
NOISE_LIMITS = {"clean": 0.02, "moderate": 0.04, "noisy": 0.25}


def noise_of(image: Tensor) -> str:
    """Name the search for the noisiest of the images (N, C, H, W) of displayed values: a key of SEARCHES."""
    finite = torch.nan_to_num(image.float(), 0, 0, 0)
    level = float(noise_level(finite).max()) if finite.numel() else 0.0
    return next((name for name, limit in NOISE_LIMITS.items() if level < limit), "strong")


def searches_for(images: Tensor) -> list[Search]:
    """The search that suits the noise of each of the images (N, C, H, W) of displayed values."""
    return [SEARCHES[noise_of(image[None])] for image in images]
