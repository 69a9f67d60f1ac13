"""Validation on the held-out last frames of the training clips."""

from collections.abc import Sequence

import torch
from torch import Tensor

from nte.color import compress, display, per_sequence
from nte.frames.clip import Clip
from nte.models.temporal import TemporalDenoiser


@torch.no_grad()
def validate(
    denoiser: TemporalDenoiser, clips: Sequence[Clip], channels: Sequence[str], holdout: int
) -> tuple[dict[str, float], Tensor]:
    """Run whole clips and look at their last `holdout` frames (at least one), which training never saw.

    Returns the mean log-L1 and PSNR (peak 1, display transform), and a picture (3, H, 3·W) of the last clip:
    noisy, denoised, reference.
    """
    errors: list[Tensor] = []
    psnr: list[Tensor] = []
    pictures: list[Tensor] = []
    for clip in clips:
        state = None
        for i in range(len(clip)):
            frame = clip.frame(i, channels).torch(next(denoiser.parameters()).device)
            result, state = denoiser.step(frame, state)
            if i < len(clip) - max(1, holdout):
                continue
            exposure = state.exposure.nan_to_num(1)
            scale = per_sequence(exposure)
            errors.append((compress(result.image * scale) - compress(frame["reference"] * scale)).abs().mean())
            pictures = [display(x, exposure) for x in (frame["color"], result.image, frame["reference"])]
            psnr.append(-10 * (pictures[1] - pictures[2]).square().mean().log10())
    scores = {"validation_l1": torch.stack(errors).mean().item(), "validation_psnr": torch.stack(psnr).mean().item()}
    return scores, torch.cat(pictures, 3)[0].cpu()
