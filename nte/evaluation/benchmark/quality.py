"""The quality of a benchmark's images: PSNR and FLIP of a clip's frames against their reference."""

from pathlib import Path
from typing import NamedTuple

import torch

from nte.evaluation.metrics import flip_map, psnr, region_mean
from nte.evaluation.targets import displayed, read_truth
from nte.frames.channels import reference_of
from nte.frames.clip import Clip, Pixels
from nte.frames.frame import Frame
from nte.frames.scalars import given_exposure, sequence_scalars


class Quality(NamedTuple):
    """The quality of one image; None where no pixel of the reference is usable."""

    psnr: float | None  # dB
    flip: float | None


class Judge:
    """Scores images of one target of a clip, in its own size.

    Frames are counted as the benchmark counts them: after the last one the clip starts again. `scores` is false for a
    clip without the target's reference, which cannot be judged.
    """

    def __init__(self, folder: Path, target: str) -> None:
        self.clip, self.target = Clip(folder), target
        name = reference_of(target)
        self.scores = name in self.clip.channels
        self._channels = [n for n in (name, f"{name}_a", f"{name}_b") if n in self.clip.channels]
        first = [n for n in ("color", "depth") if n in self.clip.channels]
        frame = self.clip.frame(0, first)
        measured = "color" in frame or frame.exposure is not None
        self._exposure = torch.from_numpy(sequence_scalars(frame)[0]) if measured else torch.ones(1)

    def score(self, index: int, image: Pixels, spec: str) -> Quality:
        """Score the image (1, C, H, W) that a denoiser made of frame `index`.

        Raises NteError, which names the denoiser's specification, for an image with pixels that are not finite.
        """
        frame = self.clip.frame(index % len(self.clip), self._channels).torch()
        given = given_exposure(frame)
        exposure = self._exposure if given is None else torch.from_numpy(given)
        return quality(frame, torch.as_tensor(image), self.target, exposure, f"{spec} on {self.clip.folder}")


def quality(frame: Frame, image: torch.Tensor, target: str, exposure: torch.Tensor, where: str) -> Quality:
    """Compare an image (1, C, H, W) of a target with the reference in a PyTorch frame, over its usable pixels.

    exposure: (1,), of the frame. where: begins the message of an NteError.
    """
    truth = read_truth(frame, target, exposure, where)
    shown = displayed(image, target, exposure, f"{where}, frame {frame.index}", frame.size)
    shown = torch.where(truth.usable, shown, truth.image)  # pixels around unusable ones see no error there
    return Quality(psnr(shown, truth.image, truth.usable), region_mean(flip_map(shown, truth.image), truth.usable))
