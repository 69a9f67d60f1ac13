"""What `align_taa` and `align_accumulate` share: motion from the images, from geometry or none, and its patch error."""

from typing import Any, NamedTuple

import torch
from torch import Tensor

from nte.errors import NteError
from nte.filters.estimated import Chooser
from nte.frames.frame import Frame
from nte.motion.correspondence import find_correspondence, patch_error
from nte.motion.geometric import traditional_motion
from nte.motion.warp import inside, pixel_centres

MOTIONS = ("estimate", "zero", "geometric")


class Aligned(NamedTuple):
    """Where history lies, and how different the patches are there."""

    motion: Tensor  # (N, 2, H, W) pixels, current → previous, finite
    valid: Tensor  # (N, 1, H, W) bool: in the previous frame
    error: Tensor  # (N, 1, H, W) patch distance in the units of the search's norm


def check_motion(name: str, motion: str) -> None:
    """Raise NteError where a filter called `name` cannot take its motion from there."""
    if motion not in MOTIONS:
        raise NteError(f"{name}: motion is '{motion}', expected one of {', '.join(MOTIONS)}")


def check_range(name: str, **values: float) -> None:
    """Raise NteError unless 0 < alpha ≤ 1 and every other value is at least 0 and finite."""
    for key, value in values.items():
        if key == "alpha" and not 0 < value <= 1:
            raise NteError(f"{name}: alpha is {value}, expected a weight of the current frame in (0, 1]")
        if not 0 <= value < float("inf"):
            raise NteError(f"{name}: {key} is {value}, expected a number of at least 0")


def chooser(noise: str, radii: str, norm: str = "") -> Chooser:
    """The chooser of the search for this noise; radii, as `10-4-2-2`, and norm replace its own unless ""."""
    changes: dict[str, Any] = {"norm": norm} if norm else {}
    if radii:
        try:
            changes |= {"radii": tuple(int(part) for part in radii.split("-")), "error_level": 0}
        except ValueError:
            expected = "expected whole numbers, finest level first, such as 10-4-2-2"
            raise NteError(f"radii are '{radii}', {expected}") from None
    return Chooser(noise, changes)


def align(current: Tensor, previous: Tensor, frame: Frame, motion: str, choose: Chooser) -> Aligned:
    """Align `previous` with `current`, (N, C, H, W) in about [0, 1], as the search compares them.

    motion: one of MOTIONS; geometric is the frame's channel. Where motion is given its patch error is measured
    with the same norm and the patches of the same level, so that rejection means the same.
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
