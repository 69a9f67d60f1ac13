"""Validation during training, on separate clips or on the held-out last frames of training clips."""

import re
import warnings
from collections.abc import Sequence
from itertools import chain, zip_longest
from typing import NamedTuple

import torch
from torch import Tensor

from nte.color import psnr
from nte.denoiser import Denoiser
from nte.errors import NteError
from nte.filters.prior import complete
from nte.frames.clip import Clip
from nte.frames.reference import count_bad_pixels
from nte.frames.scalars import sequence_exposure
from nte.models.trainable import TrainableDenoiser
from nte.training.clips import BrokenClipWarning
from nte.training.distances import masked_mean, usable_reference
from nte.training.target import Target
from nte.training.tiles import BrokenClipError


class ValidationSet(NamedTuple):
    """Validation clips, and how many of their last frames count; 0: all but the first, which has no history."""

    clips: Sequence[Clip]
    frames: int

    def first(self, clip: Clip) -> int:
        """Return the index of the first frame of a clip that counts."""
        return max(0, len(clip) - self.frames) if self.frames else min(1, len(clip) - 1)


class Validation(NamedTuple):
    """The scores by name, and a picture (3, H, 3·W) of the last clip: noisy, denoised, reference."""

    scores: dict[str, float]
    picture: Tensor

    @property
    def psnr(self) -> float:
        """The PSNR in dB by which the best checkpoint is chosen."""
        return self.scores["validation_psnr"]


def families(clips: Sequence[Clip]) -> dict[str, list[Clip]]:
    """Group clips by family: the name without the number at its end, after the folder's name if there are several."""
    several = len({clip.folder.resolve().parent for clip in clips}) > 1
    found: dict[str, list[Clip]] = {}
    for clip in clips:
        stem = re.sub(r"[\W_]*\d+$", "", clip.name) or "clips"
        parent = clip.folder.resolve().parent.name
        found.setdefault(f"{parent}/{stem}" if several else stem, []).append(clip)
    return found


def spread(clips: Sequence[Clip], count: int) -> list[Clip]:
    """Choose at most `count` clips: the first of every family, then the second of every family, and so on."""
    rounds = zip_longest(*families(clips).values())
    return [clip for clip in chain.from_iterable(rounds) if clip is not None][:count]


@torch.no_grad()
def validate(denoiser: TrainableDenoiser, chosen: ValidationSet) -> Validation:
    """Denoise whole clips and score the frames that count: log-L1 and PSNR (peak 1, display transform).

    A family's score is the mean over its frames; validation_l1 and validation_psnr are means over families. If there
    are several families, validation_psnr/NAME is the score of each. Unusable reference pixels are left out. A clip that
    cannot be read, or with more than a tenth of such pixels in a frame, is left out each time with a warning
    (BrokenClipWarning). Raises NteError if no clip is left.
    """
    device = next(denoiser.parameters()).device
    whole = complete(denoiser, str(device))
    l1: list[float] = []
    ratios: dict[str, float] = {}
    pictures: list[Tensor] = []
    faults: list[BrokenClipError] = []
    for family, clips in families(chosen.clips).items():
        errors: list[Tensor] = []
        decibels: list[Tensor] = []
        for clip in clips:
            try:
                scored = _score(whole, device, clip, chosen.first(clip))
            except BrokenClipError as error:
                warnings.warn(f"left out of validation: {error}", BrokenClipWarning, stacklevel=2)
                faults.append(error)
                continue
            errors += scored[0]
            decibels += scored[1]
            pictures = scored[2]
        if not errors:
            continue
        l1.append(torch.stack(errors).mean().item())
        ratios[family] = torch.stack(decibels).mean().item()
    if not pictures:
        raise NteError(f"no clip to validate on: {faults[0]}")
    scores = {"validation_l1": sum(l1) / len(l1), "validation_psnr": sum(ratios.values()) / len(ratios)}
    if len(ratios) > 1:
        scores |= {f"validation_psnr/{family}": value for family, value in ratios.items()}
    return Validation(scores, torch.cat(pictures, 3)[0].cpu())


def _score(
    denoiser: Denoiser, device: torch.device, clip: Clip, first: int
) -> tuple[list[Tensor], list[Tensor], list[Tensor]]:
    """Log-L1 and PSNR of each frame that counts, and noisy, denoised and reference image of the last frame.

    Raises BrokenClipError for a clip that cannot be used.
    """
    target = Target(denoiser.target)
    wanted = dict.fromkeys((*denoiser.needs, *denoiser.optional, target.reference, target.name, "color"))
    channels = [name for name in wanted if name in clip.channels]
    errors, decibels = [], []
    pictures: list[Tensor] = []
    state = known = None
    for i in range(len(clip)):
        try:
            frame = clip.frame(i, channels).torch(device)
            if i >= first:
                count_bad_pixels(frame, target.reference, clip.folder)
        except NteError as error:
            raise BrokenClipError(str(error)) from error
        result, state = denoiser.step(frame, state)
        known = sequence_exposure(frame, known)
        if i < first:
            continue
        exposure = torch.from_numpy(known).to(device).nan_to_num(1)  # NaN while there was no light yet
        reference, usable = usable_reference(frame[target.reference], exposure)
        ours, clean = (target.in_space(image, exposure, "log") for image in (result.image, reference))
        errors.append(masked_mean((ours - clean).abs(), usable))
        pictures = [target.displayed(x, exposure) for x in (frame[target.name], result.image, reference)]
        decibels.append(psnr(masked_mean((pictures[1] - pictures[2]).square(), usable)))
    return errors, decibels, [picture.expand(-1, 3, -1, -1) for picture in pictures]
