"""Training losses over an unrolled sequence: spatial, temporal and motion occlusion loss.

Source: Zeng et al., «Neural Temporal Denoising for Indirect Illumination», Eqs. 5 and 6. Settings cover what the paper
leaves open: the space in which losses are measured, and the normalisation of the masked loss. Other distances, a loss
of structure and one along the motion are further choices.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.profiler import record_function

from nte.color import demodulate
from nte.denoiser import Denoiser, State
from nte.errors import NteError
from nte.frames.channels import COMPONENTS
from nte.frames.frame import Frame
from nte.motion.warp import warp
from nte.training.batch import Batch, as_frames
from nte.training.distances import DISTANCES, masked_mean, structure_error, usable_reference
from nte.training.target import Target

LEAST_HIDDEN = 0.01  # least share of hidden pixels by which the occlusion loss is normalised
HIDDEN = "disoccluded"  # extra of a network (N, 1, H, W): 1 where the previous frame did not see the surface


@dataclass
class LossConfig:
    """The weights of the losses, and the space and distance by which they are measured."""

    spatial: float = 1.0
    temporal: float = 1.0
    occlusion: float = 1.0  # multiplied by the weight of the phase
    irradiance: float = 0.0  # weight of the spatial loss on light divided by its texture (not in the paper)
    warped: float = 0.0  # weight of the temporal loss along the motion (not in the paper)
    structure: float = 0.0  # weight of 1 − MS-SSIM of displayed images (not in the paper)
    lights: dict[str, float] = field(default_factory=dict)  # weights of the spatial losses of single components
    space: str = "log"  # linear, log (log(1 + exposed)) or display
    distance: str = "l1"  # l1, smape or charbonnier, in that space; the paper's is l1
    mask_weights: list[float] = field(default_factory=lambda: [1.0, 0.8, 0.6])  # w_k of frames i, i−1, i−2
    normalise_occlusion: bool = False  # true: by the batch's masked weight instead of all pixels (not in the paper)

    def check(self) -> None:
        """Raise NteError for an unknown space or distance, and for mask weights that are missing or not usable."""
        if not self.mask_weights:
            raise NteError("loss.mask_weights is empty, expected a weight for this frame's mask at least")
        if not all(0 <= weight < math.inf for weight in self.mask_weights):
            raise NteError(f"loss.mask_weights is {self.mask_weights}, expected finite numbers of 0 or more")
        for name, weight in self.lights.items():
            if name not in COMPONENTS or not 0 <= weight < math.inf:
                known = ", ".join(COMPONENTS)
                raise NteError(f"loss.lights has '{name}: {weight}', expected weights from 0 of some of {known}")
        for key, allowed in (("space", ("linear", "log", "display")), ("distance", tuple(DISTANCES))):
            if getattr(self, key) not in allowed:
                choices = f"{', '.join(allowed[:-1])} or {allowed[-1]}"
                raise NteError(f"loss.{key} is '{getattr(self, key)}', expected {choices}")

    def channels(self, target: Target) -> tuple[str, ...]:
        """List the channels that the loss of a target needs. Raises NteError for irradiance without a texture."""
        more = [Target(name).reference for name, weight in self.lights.items() if weight]
        more += ["motion"] if self.warped else []
        if not self.irradiance:
            return (target.reference, *more)
        if target.texture is None:
            raise NteError(f"loss.irradiance is {self.irradiance}, but '{target.name}' has no texture: set it to 0")
        return target.reference, target.texture, *more


def occlusion_loss(error: Tensor, weights: Tensor, normalise: bool) -> Tensor:
    """Compute Eq. 5: the mean of weights ⊙ error (N, C, H, W), weights Σ w_k M_k (N, 1, H, W); 0 if none is hidden.

    The paper averages over all pixels, so that the loss depends on how many are hidden. normalise: divide by the mean
    weight of the batch instead, so that every hidden pixel counts alike; but by 0.01 at least, or a single hidden pixel
    would get the gradient of all.
    """
    mean = (weights * error).mean()
    return mean / weights.mean().clamp(min=LEAST_HIDDEN) if normalise else mean


class Compared(NamedTuple):
    """A frame's image and reference (N, C, H, W) in the space of the losses."""

    image: Tensor
    reference: Tensor
    usable: Tensor  # (N, 1, H, W), bool: pixels of the reference that count
    clean: Tensor  # the reference in its units, 0 where it is not usable


class Past(NamedTuple):
    """What a window of a sequence leaves to the next one, without gradients."""

    state: State
    compared: Compared | None
    masks: list[Tensor]  # of HIDDEN, newest first


class Unrolled(NamedTuple):
    """The loss of a window, its parts as means per frame, and what the next window begins with."""

    loss: Tensor
    parts: dict[str, Tensor]
    past: Past


class SequenceLoss(nn.Module):
    """The loss of a denoiser unrolled over a sequence: the mean of its frames' losses.

    The paper sums them, which makes no difference to Adam unless gradients are clipped. All is one module, so that
    DistributedDataParallel sees the whole recurrence as one forward pass. mixed: the denoiser's steps compute in
    bfloat16. Raises NteError for a configuration that is not valid.
    """

    def __init__(self, denoiser: Denoiser, config: LossConfig, mixed: bool = False) -> None:
        super().__init__()
        config.check()
        self.denoiser, self.config, self.mixed = denoiser, config, mixed
        self.target, self.distance = Target(denoiser.target), DISTANCES[config.distance]

    def forward(
        self, batch: Batch, occlusion: float, warmup: int = 0, window: slice = slice(None), past: Past | None = None
    ) -> Unrolled:
        """Unroll the frames of a window; the first `warmup` frames of the batch run without gradients or losses.

        occlusion: weight of the occlusion loss in this phase of training, multiplied by the configured one. window: the
        frames to unroll; the losses of the windows of a batch sum to that of the batch. past: what the window before
        has left; None at the start.
        """
        weights = replace(self.config, occlusion=occlusion * self.config.occlusion)
        asked = (HIDDEN,) if weights.occlusion else ()
        lights = {name: weight for name, weight in weights.lights.items() if weight}
        found: dict[str, list[Tensor]] = {}
        state, before, masks = past or Past(None, None, [])
        for i, frame in enumerate(as_frames(batch)):
            if i not in range(*window.indices(len(batch))):
                continue
            with torch.set_grad_enabled(torch.is_grad_enabled() and i >= warmup):
                with (
                    record_function("train/denoiser"),
                    torch.autocast(frame[self.target.reference].device.type, torch.bfloat16, enabled=self.mixed),
                ):
                    result, state = self.denoiser.step(frame, state, (*asked, *lights))
                masks = [*(result.extras[name] for name in asked), *masks][: len(weights.mask_weights)]
                with record_function("train/losses"):
                    compared = self._compared(frame, result.image)
                    if i >= warmup:
                        parts = self._parts(frame, result.image, compared, before, masks, weights)
                        parts |= {name: self._of_light(name, result.extras[name], frame) for name in lights}
                        for name, part in parts.items():
                            found.setdefault(name, []).append(part)
            before = compared
            # Nothing is hidden in a frame without a previous one: it has no mask for later frames to look back to.
            masks = masks if i else []
        factors = {name: getattr(weights, name, 0.0) for name in found} | lights
        weighted = [factors[name] * torch.stack(values).sum() for name, values in found.items()]
        means = {name: torch.stack(values).mean().detach() for name, values in found.items()}
        loss = torch.stack(weighted).sum() / (len(batch) - warmup)
        return Unrolled(loss, means, detached(Past(state, before, masks)))

    def _compared(self, frame: Frame, image: Tensor) -> Compared:
        exposure = frame.exposure
        assert exposure is not None  # every batch has one
        clean, usable = usable_reference(frame[self.target.reference], exposure)
        shown, reference = (self.target.in_space(x, exposure, self.config.space) for x in (image, clean))
        return Compared(shown, reference, usable, clean)

    def _parts(
        self, frame: Frame, image: Tensor, now: Compared, before: Compared | None, masks: Sequence[Tensor],
        weights: LossConfig,
    ) -> dict[str, Tensor]:  # fmt: skip
        """The losses of one frame that has this image (N, C, H, W), by their names in the configuration."""
        parts = {"spatial": masked_mean(self._error(now.image, now.reference), now.usable)}
        magnitude = now.image.abs() + now.reference.abs()
        if before is not None:
            change = (now.image - before.image) - (now.reference - before.reference)
            parts["temporal"] = masked_mean(self.distance(change, magnitude), now.usable & before.usable)
        if before is not None and weights.warped:
            # The difference of two warped images is the warped difference.
            known = before.usable.to(now.image.dtype)
            past = warp(torch.cat([(before.image - before.reference) * known, known], 1), frame["motion"])
            seen = now.usable & past.valid & (past.image[:, -1:] > 1 - 1e-4)
            change = (now.image - now.reference) - past.image[:, :-1]
            parts["warped"] = masked_mean(self.distance(change, magnitude), seen)
        if weights.occlusion:
            hidden = self._mask(masks) * now.usable
            error = self._error(now.image, now.reference)
            parts["occlusion"] = occlusion_loss(error, hidden, weights.normalise_occlusion)
        exposure, pair = frame.exposure, (image, now.clean)
        assert exposure is not None
        if weights.irradiance and self.target.texture:
            texture = frame[self.target.texture]
            light = [self.target.in_space(demodulate(x, texture), exposure, weights.space) for x in pair]
            parts["irradiance"] = masked_mean(self._error(*light), now.usable)
        if weights.structure:
            shown, reference = (self.target.displayed(x, exposure) for x in pair)
            parts["structure"] = structure_error(shown, reference, now.usable)
        return parts

    def _error(self, image: Tensor, reference: Tensor) -> Tensor:
        return self.distance(image - reference, image.abs() + reference.abs())

    def _of_light(self, name: str, image: Tensor, frame: Frame) -> Tensor:
        """The spatial loss of a single light component."""
        light, exposure = Target(name), frame.exposure
        assert exposure is not None
        clean, usable = usable_reference(frame[light.reference], exposure)
        ours, theirs = (light.in_space(x, exposure, self.config.space) for x in (image, clean))
        return masked_mean(self._error(ours, theirs), usable)

    def _mask(self, masks: Sequence[Tensor]) -> Tensor:
        """Σ w_k M_k over this frame's mask and the earlier ones, newest first; this frame's replaces a missing one."""
        chosen = [masks[k] if k < len(masks) else masks[0] for k in range(len(self.config.mask_weights))]
        return torch.stack([w * m for w, m in zip(self.config.mask_weights, chosen, strict=True)]).sum(0)


def windows(frames: int, warmup: int, length: int) -> list[slice]:
    """Cut a sequence into windows of `length` frames, 0 for one of all; warm-up frames belong to the first."""
    starts = list(range(warmup, frames, length or frames))
    return [
        slice(start if start > warmup else 0, stop) for start, stop in zip(starts, [*starts[1:], frames], strict=True)
    ]


def detached(value: State) -> State:
    """Copy a state, of tensors in named tuples, tuples, lists and mappings, without its gradients."""
    if isinstance(value, Tensor):
        return value.detach()
    if isinstance(value, Mapping):
        return {key: detached(item) for key, item in value.items()}
    if isinstance(value, tuple) and hasattr(value, "_fields"):
        return type(value)(*map(detached, value))
    return type(value)(map(detached, value)) if isinstance(value, tuple | list) else value
