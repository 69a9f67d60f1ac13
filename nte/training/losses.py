"""Training losses over an unrolled sequence: spatial, temporal and motion occlusion loss.

Zeng et al., «Neural Temporal Denoising for Indirect Illumination», Eqs. 5 and 6. What they leave open (the
space the losses live in, normalising the masked one) is a setting.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import torch
from torch import Tensor, nn

from nte.color import demodulate, per_sequence
from nte.denoiser import Denoiser, State
from nte.errors import NteError
from nte.training.batch import Batch, as_frames
from nte.training.target import Target

LEAST_HIDDEN = 0.01  # share of the pixels
HIDDEN = "disoccluded"  # extra of a network (N, 1, H, W): 1 where the previous frame did not see the surface
BRIGHTEST = 65504.0  # of an exposed reference: beyond, nobody sees a difference


@dataclass
class LossConfig:
    """Weights of the parts and the space they are measured in."""

    spatial: float = 1.0
    temporal: float = 1.0
    occlusion: float = 1.0  # times that of the phase
    irradiance: float = 0.0  # the spatial loss once more, on the light without the albedo (ours)
    space: str = "log"  # linear, log (log(1 + exposed)) or display
    mask_weights: list[float] = field(default_factory=lambda: [1.0, 0.8, 0.6])  # w_k of frames i, i−1, i−2
    normalise_occlusion: bool = False  # by the batch's masked weight instead of all pixels (ours)

    def check(self) -> None:
        """Raise NteError for an unknown space and for no mask weights."""
        if not self.mask_weights:
            raise NteError("loss.mask_weights is empty, expected a weight for this frame's mask at least")
        if self.space not in ("linear", "log", "display"):
            raise NteError(f"loss.space is '{self.space}', expected linear, log or display")

    def channels(self, target: Target) -> tuple[str, ...]:
        """Channels that the loss of a target needs. Raises NteError where it cannot be measured."""
        if not self.irradiance:
            return (target.reference,)
        if target.texture is None:
            raise NteError(f"loss.irradiance is {self.irradiance}, but '{target.name}' has no texture: set it to 0")
        return target.reference, target.texture


def masked_mean(values: Tensor, usable: Tensor) -> Tensor:
    """Mean of values (N, C, H, W) over the usable pixels (N, 1, H, W), bool; 0 where there are none.

    Values elsewhere must be finite. The plain mean, bit for bit, where every pixel is usable.
    """
    share = usable.to(values.dtype).mean()
    return (values * usable).mean() / torch.where(share > 0, share, 1.0)


def usable_reference(reference: Tensor, exposure: Tensor) -> tuple[Tensor, Tensor]:
    """A reference (N, 3, H, W) that losses can compare with, and where it says something: (N, 1, H, W), bool.

    A pixel that is NaN, infinite or negative in any component says nothing, and is 0. What is brighter than BRIGHTEST
    when exposed counts as that bright.
    """
    scale = per_sequence(exposure)
    usable = ((reference >= 0) & (reference * scale < float("inf"))).all(1, keepdim=True)
    return torch.where(usable, reference, 0.0).minimum(BRIGHTEST / scale), usable


def occlusion_loss(image: Tensor, reference: Tensor, weights: Tensor, normalise: bool) -> Tensor:
    """Eq. 5: L1 of weights ⊙ (I, R), weights Σ w_k M_k (N, 1, H, W); 0 where nothing is hidden.

    The paper's mean is over all pixels, so that the size of the loss depends on how many are hidden. normalise: by the
    weight of the whole batch, so that every hidden pixel of it counts alike, and by that of LEAST_HIDDEN of the pixels
    at least: a single hidden pixel would get the gradient of all.
    """
    error = (weights * (image - reference).abs()).mean()
    return error / weights.mean().clamp(min=LEAST_HIDDEN) if normalise else error


class SequenceLoss(nn.Module):
    """Unrolls the denoiser over a clip; the loss is the mean of its frames' losses.

    The paper sums them, which Adam does not see. One module, so that DistributedDataParallel sees the whole
    recurrence as one forward pass.
    """

    def __init__(self, denoiser: Denoiser, config: LossConfig, precision: str = "32-true") -> None:
        super().__init__()
        config.check()
        self.denoiser, self.config, self.mixed = denoiser, config, precision == "bf16-mixed"
        self.target = Target(denoiser.target)

    def forward(self, batch: Batch, occlusion: float, warmup: int = 0) -> tuple[Tensor, dict[str, Tensor]]:
        """(loss, its parts as means per frame); the first `warmup` frames are denoised but not counted.

        occlusion: weight of the occlusion loss in this phase of training, times the configured one.
        """
        weights = replace(self.config, occlusion=occlusion * self.config.occlusion)
        parts: dict[str, list[Tensor]] = {}
        state: State | None = None
        target = self.target
        asked = (HIDDEN,) if weights.occlusion else ()
        masks: list[Tensor] = []
        before: tuple[Tensor, Tensor, Tensor] | None = None
        for i, frame in enumerate(as_frames(batch)):
            clean, exposure = frame[target.reference], frame.exposure
            assert exposure is not None  # batches have it
            with torch.autocast(clean.device.type, torch.bfloat16, enabled=self.mixed):
                result, state = self.denoiser.step(frame, state, asked)
            clean, usable = usable_reference(clean, exposure)
            image, reference = (target.in_space(x, exposure, weights.space) for x in (result.image, clean))
            masks = [result.extras[name] for name in asked] + masks
            if i >= warmup:
                parts.setdefault("spatial", []).append(masked_mean((image - reference).abs(), usable))
                if before is not None:
                    change = (image - before[0]) - (reference - before[1])
                    parts.setdefault("temporal", []).append(masked_mean(change.abs(), usable & before[2]))
                if weights.occlusion:
                    hidden = self._mask(masks) * usable
                    masked = occlusion_loss(image, reference, hidden, weights.normalise_occlusion)
                    parts.setdefault("occlusion", []).append(masked)
                if weights.irradiance and target.texture:
                    texture = frame[target.texture]
                    light = [
                        target.in_space(demodulate(x, texture), exposure, weights.space) for x in (result.image, clean)
                    ]
                    parts.setdefault("irradiance", []).append(masked_mean((light[0] - light[1]).abs(), usable))
            before = image, reference, usable
        weighted = [getattr(weights, name) * torch.stack(values).sum() for name, values in parts.items()]
        means = {name: torch.stack(values).mean().detach() for name, values in parts.items()}
        return torch.stack(weighted).sum() / (len(batch) - warmup), means

    def _mask(self, masks: Sequence[Tensor]) -> Tensor:
        """Σ w_k M_k over this frame's mask and those before it; a missing earlier one is this frame's."""
        chosen = [masks[k] if k < len(masks) else masks[0] for k in range(len(self.config.mask_weights))]
        return torch.stack([w * m for w, m in zip(self.config.mask_weights, chosen, strict=True)]).sum(0)
