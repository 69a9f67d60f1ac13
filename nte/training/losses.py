"""Training losses over an unrolled sequence: spatial, temporal and motion occlusion loss.

Zeng et al., «Neural Temporal Denoising for Indirect Illumination», Eqs. 5 and 6. What they leave open (the
space the losses live in, normalising the masked one) is a setting.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import torch
from torch import Tensor, nn

from nte.color import compress, demodulate, display, per_sequence
from nte.errors import NteError
from nte.models.temporal import TemporalDenoiser, TemporalState
from nte.training.batch import Batch, as_frames


@dataclass
class LossConfig:
    """Weights of the parts and the space they are measured in."""

    spatial: float = 1.0
    temporal: float = 1.0
    occlusion: float = 1.0  # times that of the phase
    irradiance: float = 0.0  # the spatial loss once more, on the light without the albedo (ours)
    space: str = "log"  # linear, log (log(1 + exposed)) or display
    mask_weights: list[float] = field(default_factory=lambda: [1.0, 0.8, 0.6])  # w_k of frames i, i−1, i−2
    normalise_occlusion: bool = False  # by the masked weight instead of all pixels (ours)

    def check(self) -> None:
        """Raise NteError for an unknown space and for no mask weights."""
        if not self.mask_weights:
            raise NteError("loss.mask_weights is empty, expected a weight for this frame's mask at least")
        if self.space not in ("linear", "log", "display"):
            raise NteError(f"loss.space is '{self.space}', expected linear, log or display")


def to_space(radiance: Tensor, exposure: Tensor, space: str) -> Tensor:
    """Radiance (N, 3, H, W) in the space where losses are measured."""
    if space == "display":
        return display(radiance, exposure)
    exposed = radiance * per_sequence(exposure)
    return compress(exposed) if space == "log" else exposed


def occlusion_loss(image: Tensor, reference: Tensor, weights: Tensor, normalise: bool) -> Tensor:
    """Eq. 5: L1 of weights ⊙ (I, R), weights Σ w_k M_k (N, 1, H, W); 0 where nothing is hidden.

    The paper's mean is over all pixels, so that the size of the loss depends on how many are hidden.
    """
    error = (weights * (image - reference).abs()).mean((1, 2, 3))
    return (error / weights.mean((1, 2, 3)).clamp(min=1e-6)).mean() if normalise else error.mean()


class SequenceLoss(nn.Module):
    """Unrolls the denoiser over a clip; the loss is the mean of its frames' losses.

    The paper sums them, which Adam does not see. One module, so that DistributedDataParallel sees the whole
    recurrence as one forward pass.
    """

    def __init__(self, denoiser: TemporalDenoiser, config: LossConfig, precision: str = "32-true") -> None:
        super().__init__()
        config.check()
        self.denoiser, self.config, self.mixed = denoiser, config, precision == "bf16-mixed"

    def forward(self, batch: Batch, occlusion: float, warmup: int = 0) -> tuple[Tensor, dict[str, Tensor]]:
        """(loss, its parts as means per frame); the first `warmup` frames are denoised but not counted.

        occlusion: weight of the occlusion loss in this phase of training, times the configured one.
        """
        weights = replace(self.config, occlusion=occlusion * self.config.occlusion)
        parts: dict[str, list[Tensor]] = {}
        state: TemporalState | None = None
        masks: list[Tensor] = []
        before: tuple[Tensor, Tensor] | None = None
        for i, frame in enumerate(as_frames(batch)):
            with torch.autocast(frame["color"].device.type, torch.bfloat16, enabled=self.mixed):
                result, state = self.denoiser.step(frame, state, ("disoccluded",))
            masks.insert(0, result.extras["disoccluded"])
            image = to_space(result.image, state.exposure, weights.space)
            reference = to_space(frame["reference"], state.exposure, weights.space)
            if i >= warmup:
                parts.setdefault("spatial", []).append((image - reference).abs().mean())
                if before is not None:
                    change = (image - before[0]) - (reference - before[1])
                    parts.setdefault("temporal", []).append(change.abs().mean())
                if weights.occlusion:
                    masked = occlusion_loss(image, reference, self._mask(masks), weights.normalise_occlusion)
                    parts.setdefault("occlusion", []).append(masked)
                if weights.irradiance:
                    light = [
                        to_space(demodulate(x, frame["albedo"]), state.exposure, weights.space)
                        for x in (result.image, frame["reference"])
                    ]
                    parts.setdefault("irradiance", []).append((light[0] - light[1]).abs().mean())
            before = image, reference
        weighted = [getattr(weights, name) * torch.stack(values).sum() for name, values in parts.items()]
        means = {name: torch.stack(values).mean().detach() for name, values in parts.items()}
        return torch.stack(weighted).sum() / (len(batch) - warmup), means

    def _mask(self, masks: Sequence[Tensor]) -> Tensor:
        """Σ w_k M_k over this frame's mask and those before it; a missing earlier one is this frame's."""
        chosen = [masks[k] if k < len(masks) else masks[0] for k in range(len(self.config.mask_weights))]
        return torch.stack([w * m for w, m in zip(self.config.mask_weights, chosen, strict=True)]).sum(0)
