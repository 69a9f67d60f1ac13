"""Shared parts of `align_taa` and `align_accumulate`: motion estimated or given, and its patch error."""

from dataclasses import dataclass
from typing import Literal, NamedTuple, TypeAlias

import torch
from torch import Tensor

from nte.errors import NteError
from nte.filters.estimated import Chooser, Noise
from nte.frames.frame import Frame
from nte.motion.correspondence import find_correspondence, patch_error
from nte.motion.geometric import traditional_motion
from nte.motion.warp import inside, pixel_centres
from nte.options import Alpha, NotNegative, Options

Motion: TypeAlias = Literal["estimate", "zero", "geometric"]


@dataclass(frozen=True)
class SearchOptions(Options):
    """Options that both filters have.

    motion: `estimate` (the paper), `zero`, or `geometric` (the channel `motion`); the rejection is the same for all
    three. noise: of the frames, which chooses the search: `auto` (measured), `clean`, `moderate`, `noisy` or `strong`.
    radii: patch radii in px, finest level first, such as 10-4-2-2, instead of those of the search. alpha: least weight
    of the current frame, in (0, 1]. kappa, eta: the mask m = κ ε − η rejects history with a large patch error ε.
    """

    motion: Motion = "estimate"
    noise: Noise = "auto"
    radii: tuple[int, ...] = ()
    alpha: Alpha = 0.1
    kappa: NotNegative = 2.0
    eta: NotNegative = 1.6

    def __post_init__(self) -> None:
        super().__post_init__()
        try:
            self.chooser()
        except NteError as error:
            raise NteError(f"{self.name}: {error}") from None

    def chooser(self) -> Chooser:
        """Return the chooser of the search for this noise, with these radii."""
        return Chooser(self.noise, {"radii": self.radii, "error_level": 0} if self.radii else {})


class Aligned(NamedTuple):
    """Where history lies, and how different the patches are there."""

    motion: Tensor  # (N, 2, H, W) pixels, current → previous, finite
    valid: Tensor  # (N, 1, H, W) bool: in the previous frame
    error: Tensor  # (N, 1, H, W) patch distance in the units of the search's norm


def align(current: Tensor, previous: Tensor, frame: Frame, motion: Motion, choose: Chooser) -> Aligned:
    """Align `previous` with `current`, (N, C, H, W) with values in about [0, 1], as the search compares them.

    motion: how to get the motion; `geometric` takes the frame's channel. The patch error of a given motion is measured
    with the norm and the patches of the search, so that rejection means the same for found and given motion.
    """
    search = choose(current)
    if motion == "estimate":
        found = find_correspondence(current, previous, search)
        return Aligned(found.motion, inside(pixel_centres(current) + found.motion), found.error)
    if motion == "geometric":
        given = traditional_motion(frame["motion"])
        return Aligned(given.motion, given.valid, patch_error(current, previous, given.motion, search))
    still = current.new_zeros(current.shape[0], 2, *current.shape[2:])
    everywhere = torch.ones_like(still[:, :1], dtype=torch.bool)
    return Aligned(still, everywhere, patch_error(current, previous, still, search))
