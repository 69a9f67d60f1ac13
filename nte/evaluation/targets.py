"""The truth of a target, which is its reference after the display transform; and pictures of targets."""

from typing import NamedTuple

import torch
from torch import Tensor

from nte.color import display
from nte.errors import NteError
from nte.frames.channels import CHANNELS, reference_of
from nte.frames.frame import Frame
from nte.frames.reference import count_bad_pixels, usable_pixels
from nte.frames.show import RGB, quantise
from nte.viewer.recorder import BRIGHTENED


class Truth(NamedTuple):
    """A target's reference after the display transform, and its two independent halves if stored."""

    image: Tensor  # (1, 3, H, W) in [0, 1]; 0 where it is not usable
    halves: tuple[Tensor, Tensor] | None  # each as image
    usable: Tensor  # (1, 1, H, W) bool: finite and not negative in reference and halves; other pixels are not scored
    bad: int  # number of unusable pixels of the reference


def read_truth(frame: Frame, target: str, exposure: Tensor, clip: str) -> Truth:
    """Read the truth of a target in a PyTorch frame of batch 1.

    exposure: (1,), of the frame. clip: name for errors. Raises NteError if the reference is missing or if more than
    a tenth of its pixels are unusable.
    """
    name = reference_of(target)
    where = f"'{name}' of {clip}, frame {frame.index}"
    bad = count_bad_pixels(frame, name, clip)
    halves = [frame[half] for half in (f"{name}_a", f"{name}_b") if half in frame]
    images = (frame[name], *halves)
    usable = torch.stack([usable_pixels(image) for image in images]).all(0)
    shown = [displayed(torch.where(usable, image, 0.0), target, exposure, where, frame.size) for image in images]
    return Truth(shown[0], (shown[1], shown[2]) if len(halves) == 2 else None, usable, bad)


def displayed(image: Tensor, target: str, exposure: Tensor, where: str, size: tuple[int, ...]) -> Tensor:
    """Convert an image (1, C, H, W) of a target to (1, 3, H, W) in [0, 1]; radiance by the display transform.

    Other targets are clamped and repeated to three channels. exposure: (1,). size: the expected (height, width).
    Raises NteError, which begins with `where`, for an image of another size or with pixels that are not finite.
    """
    if tuple(image.shape[2:]) != size:
        raise NteError(f"{where}: the image is {tuple(image.shape)}, expected (1, C, {size[0]}, {size[1]})")
    if bad := int((~image.isfinite()).any(1).sum()):
        raise NteError(f"{where}: {bad} of {image[0, 0].numel()} pixels are not finite: it cannot be scored")
    if CHANNELS[target].shown == "radiance":
        return display(image, exposure)
    return image.clamp(0, 1).expand(-1, 3, -1, -1)


def picture(image: Tensor, target: str, exposure: Tensor) -> RGB:
    """Draw a target's image (1, C, H, W) as (H, W, 3) uint8; values that are not finite are black.

    exposure: (1,). Indirect light is drawn ten times as bright.
    """
    usable = image.nan_to_num(0, 0, 0)
    size = (image.shape[2], image.shape[3])
    return quantise(displayed(usable, target, exposure * BRIGHTENED.get(target, 1), "", size)[0].numpy())
