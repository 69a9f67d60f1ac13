"""Training losses over an unrolled sequence: spatial, temporal and motion occlusion loss.

Source: Zeng et al., «Neural Temporal Denoising for Indirect Illumination», Eqs. 5 and 6. Settings cover what the paper
leaves open: the space in which losses are measured, and the normalisation of the masked loss.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import torch
from torch import Tensor, nn

from nte.color import demodulate, per_sequence
from nte.denoiser import Denoiser, State
from nte.errors import NteError
from nte.frames.channels import COMPONENTS
from nte.frames.frame import Frame
from nte.training.batch import Batch, as_frames
from nte.training.target import Target

LEAST_HIDDEN = 0.01  # least share of hidden pixels by which the occlusion loss is normalised
HIDDEN = "disoccluded"  # extra of a network (N, 1, H, W): 1 where the previous frame did not see the surface
BRIGHTEST = 65504.0  # cap of an exposed reference; nobody sees a difference beyond


@dataclass
class LossConfig:
    """The weights of the losses, and the space in which they are measured."""

    spatial: float = 1.0
    temporal: float = 1.0
    occlusion: float = 1.0  # multiplied by the weight of the phase
    irradiance: float = 0.0  # weight of the spatial loss on light divided by its texture (not in the paper)
    lights: dict[str, float] = field(default_factory=dict)  # weights of the spatial losses of single components
    space: str = "log"  # linear, log (log(1 + exposed)) or display
    mask_weights: list[float] = field(default_factory=lambda: [1.0, 0.8, 0.6])  # w_k of frames i, i−1, i−2
    normalise_occlusion: bool = False  # true: by the batch's masked weight instead of all pixels (not in the paper)

    def check(self) -> None:
        """Raise NteError for an unknown space, and for mask weights that are missing, negative or not finite."""
        if not self.mask_weights:
            raise NteError("loss.mask_weights is empty, expected a weight for this frame's mask at least")
        if not all(0 <= weight < math.inf for weight in self.mask_weights):
            raise NteError(f"loss.mask_weights is {self.mask_weights}, expected finite numbers of 0 or more")
        for name, weight in self.lights.items():
            if name not in COMPONENTS or not 0 <= weight < math.inf:
                known = ", ".join(COMPONENTS)
                raise NteError(f"loss.lights has '{name}: {weight}', expected weights from 0 of some of {known}")
        if self.space not in ("linear", "log", "display"):
            raise NteError(f"loss.space is '{self.space}', expected linear, log or display")

    def channels(self, target: Target) -> tuple[str, ...]:
        """List the channels that the loss of a target needs. Raises NteError for irradiance without a texture."""
        references = (target.reference, *(Target(name).reference for name, weight in self.lights.items() if weight))
        if not self.irradiance:
            return references
        if target.texture is None:
            raise NteError(f"loss.irradiance is {self.irradiance}, but '{target.name}' has no texture: set it to 0")
        return *references, target.texture


def masked_mean(values: Tensor, usable: Tensor) -> Tensor:
    """Average values (N, C, H, W) over the usable pixels, bool (N, 1, H, W); 0 if there are none.

    Values elsewhere must be finite. If every pixel is usable, the result is the plain mean, bit for bit.
    """
    share = usable.to(values.dtype).mean()
    return (values * usable).mean() / torch.where(share > 0, share, 1.0)


def usable_reference(reference: Tensor, exposure: Tensor) -> tuple[Tensor, Tensor]:
    """Prepare a reference (N, C, H, W) for losses; return it with the bool mask (N, 1, H, W) of its usable pixels.

    A pixel that is NaN, infinite or negative in any component is not usable, and becomes 0. Exposed values are capped
    at 65504. exposure: (N,).
    """
    scale = per_sequence(exposure)
    usable = ((reference >= 0) & (reference * scale < float("inf"))).all(1, keepdim=True)
    return torch.where(usable, reference, 0.0).minimum(BRIGHTEST / scale), usable


def occlusion_loss(image: Tensor, reference: Tensor, weights: Tensor, normalise: bool) -> Tensor:
    """Compute Eq. 5: the L1 loss of weights ⊙ (image, reference), weights Σ w_k M_k (N, 1, H, W); 0 if none is hidden.

    The paper averages over all pixels, so that the loss depends on how many are hidden. normalise: divide by the mean
    weight of the batch instead, so that every hidden pixel counts alike; but by 0.01 at least, or a single hidden pixel
    would get the gradient of all.
    """
    error = (weights * (image - reference).abs()).mean()
    return error / weights.mean().clamp(min=LEAST_HIDDEN) if normalise else error


class SequenceLoss(nn.Module):
    """The loss of a denoiser unrolled over a sequence: the mean of its frames' losses.

    The paper sums them, which makes no difference to Adam. All is one module, so that DistributedDataParallel sees the
    whole recurrence as one forward pass. precision: 32-true, or bf16-mixed for the denoiser's steps. Raises NteError
    for a configuration that is not valid.
    """

    def __init__(self, denoiser: Denoiser, config: LossConfig, precision: str = "32-true") -> None:
        super().__init__()
        config.check()
        self.denoiser, self.config, self.mixed = denoiser, config, precision == "bf16-mixed"
        self.target = Target(denoiser.target)

    def forward(self, batch: Batch, occlusion: float, warmup: int = 0) -> tuple[Tensor, dict[str, Tensor]]:
        """Return the loss, and its parts as means per frame; the first `warmup` frames are denoised but not counted.

        occlusion: weight of the occlusion loss in this phase of training, multiplied by the configured one.
        """
        weights = replace(self.config, occlusion=occlusion * self.config.occlusion)
        parts: dict[str, list[Tensor]] = {}
        state: State | None = None
        target = self.target
        asked = (HIDDEN,) if weights.occlusion else ()
        lights = {name: weight for name, weight in weights.lights.items() if weight}
        masks: list[Tensor] = []
        before: tuple[Tensor, Tensor, Tensor] | None = None
        for i, frame in enumerate(as_frames(batch)):
            clean, exposure = frame[target.reference], frame.exposure
            assert exposure is not None  # every batch has one
            with torch.autocast(clean.device.type, torch.bfloat16, enabled=self.mixed):
                result, state = self.denoiser.step(frame, state, (*asked, *lights))
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
                for name in lights:
                    parts.setdefault(name, []).append(self._of_light(name, result.extras[name], frame))
            before = image, reference, usable
        factors = {name: getattr(weights, name, 0.0) for name in parts} | lights
        weighted = [factors[name] * torch.stack(values).sum() for name, values in parts.items()]
        means = {name: torch.stack(values).mean().detach() for name, values in parts.items()}
        return torch.stack(weighted).sum() / (len(batch) - warmup), means

    def _of_light(self, name: str, image: Tensor, frame: Frame) -> Tensor:
        """The spatial loss of a single light component."""
        light, exposure = Target(name), frame.exposure
        assert exposure is not None
        clean, usable = usable_reference(frame[light.reference], exposure)
        ours, theirs = (light.in_space(x, exposure, self.config.space) for x in (image, clean))
        return masked_mean((ours - theirs).abs(), usable)

    def _mask(self, masks: Sequence[Tensor]) -> Tensor:
        """Σ w_k M_k over this frame's mask and the earlier ones, newest first; this frame's replaces a missing one."""
        chosen = [masks[k] if k < len(masks) else masks[0] for k in range(len(self.config.mask_weights))]
        return torch.stack([w * m for w, m in zip(self.config.mask_weights, chosen, strict=True)]).sum(0)
