"""The reading of a frame by a network of light: what it filters, and the features that it sees.

Every channel is made usable (nte.frames.usable) and brought to a scale of about 1 by its kind in the table of channels,
so a further channel of the table needs no code here.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import torch
from torch import Tensor, nn

from nte.color import compress, divisor, per_sequence
from nte.errors import NteError, expected_one_of
from nte.frames.ahead import NEXT
from nte.frames.channels import CHANNELS, PRIOR, REFERENCES, TARGETS, TEXTURES, Channel, width_of
from nte.frames.usable import (
    ABSOLUTE,
    BRIGHTEST,
    usable,
    usable_depth,
    usable_direction,
    usable_reflectance,
)
from nte.models.trainable import NetworkConfig
from nte.recurrence import FORWARD

# Channels that no feature can be made of: what is learned, the future, another frame's pixels, and names of objects.
_NO_FEATURES = {*REFERENCES, PRIOR, "reference_a", "reference_b", "forward_motion", FORWARD, *NEXT}
_NO_FEATURES |= {name for name, row in CHANNELS.items() if row.kind == "id"}


@dataclass
class LightConfig(NetworkConfig):
    """Settings that all networks of light share: what they denoise, and what they see of it."""

    target: str = "color"  # color, indirect, glossy or visibility: the channel that is denoised
    inputs: list[str] = field(default_factory=list)  # further channels that the network sees, such as emission
    demodulate: bool = False  # filter light without its texture, and multiply the result by it (not in the paper)

    def check(self) -> None:
        """Raise NteError, naming the key, for values that make no network."""
        super().check()
        if self.target not in TARGETS:
            raise NteError(f"network.target is '{self.target}'{expected_one_of(self.target, TARGETS)}")
        if self.demodulate and self.target not in TEXTURES:
            raise NteError(f"network.demodulate is true, but '{self.target}' has no texture: set it to false")
        check_inputs(self.inputs, Reader(self.target).needs)


def check_inputs(names: list[str], read: tuple[str, ...]) -> None:
    """Raise NteError for a name in `network.inputs` that makes no feature, or that is read already, or comes twice."""
    for name in names:
        if name not in CHANNELS or name in _NO_FEATURES:
            allowed = [channel for channel in CHANNELS if channel not in {*_NO_FEATURES, *read}]
            raise NteError(f"network.inputs has '{name}'{expected_one_of(name, allowed)}")
        if name in read or names.count(name) > 1:
            raise NteError(f"network.inputs has '{name}', which the network sees already: leave it out")


class Seen(NamedTuple):
    """What a network sees of a frame."""

    light: Tensor  # (N, C, H, W) usable, linear: exposed light, without its texture if so configured, or a share
    features: Tensor  # (N, F, H, W) of a scale of about 1
    depth: Tensor  # (N, 1, H, W) usable, scene units; 0 = miss
    texture: Tensor | None  # (N, 3, H, W) by which the light was divided
    scale: Tensor | float  # (N, 1, 1, 1) exposure by which it was multiplied
    prior: Tensor | None = None  # (N, C, H, W) another denoiser's image, made as usable as the light


class Reader(nn.Module):
    """The step that turns a frame's channels into light and features, and filtered light into an image.

    target: the channel that is denoised. inputs: further channels that are seen. prior: another denoiser's image of the
    target is seen. The guide is the albedo of the whole surface, but that of its diffuse part for indirect light. Costs
    some operations per component, without products of components.
    """

    def __init__(
        self, target: str, inputs: tuple[str, ...] = (), demodulate: bool = False, prior: bool = False
    ) -> None:
        super().__init__()
        self.target, self.extra, self.demodulate, self.prior = target, tuple(inputs), demodulate, prior
        self.guide = TEXTURES.get(target, "albedo")
        self.needs = (target, self.guide, "normal", "depth", *self.extra, *([PRIOR] if prior else []))
        self.components = width_of(target)  # of the light
        self.is_radiance = CHANNELS[target].kind == "radiance"
        self.width = sum(map(width_of, self.needs))  # of the features
        exposed = any(_is_exposed(CHANNELS[name]) for name in (target, *self.extra))
        self.scalars = ("exposure", "depth_scale") if exposed else ("depth_scale",)  # those that `forward` reads

    @property
    def measured(self) -> tuple[str, ...]:
        """Channels that are read only to measure the scalars, where a frame does not give them."""
        return ("color",) if "exposure" in self.scalars and "color" not in self.needs else ()

    def forward(self, given: Mapping[str, Tensor]) -> Seen:
        """Read the channels of `needs` and the scalars (N,) out of `given`."""
        depth_scale, exposure = given["depth_scale"], given.get("exposure")
        scale = per_sequence(exposure) if self.is_radiance and exposure is not None else 1.0
        light, guide = usable_light(self.target, given[self.target], exposure), usable_reflectance(given[self.guide])
        texture = None
        if self.demodulate:
            light, texture = demodulated(light, given[self.guide])
        depth = usable_depth(given["depth"])
        features = [self.compressed(light), guide, usable_direction(given["normal"]), _normalised(depth, depth_scale)]
        features += [feature(name, given[name], exposure, depth_scale) for name in self.extra]
        prior = None
        if self.prior:
            prior = usable_light(self.target, given[PRIOR], exposure)
            prior = prior if texture is None else prior / texture
            features.append(self.compressed(prior))
        return Seen(light, torch.cat(features, 1), depth, texture, scale, prior)

    def compressed(self, light: Tensor) -> Tensor:
        """Compress light as features have it; a share stays as it is."""
        return compress(light) if self.is_radiance else light

    def image(self, filtered: Tensor, seen: Seen) -> Tensor:
        """Convert filtered light (N, C, H, W) to an image in the units of the target's channel."""
        image = filtered if seen.texture is None else filtered * seen.texture
        return image / seen.scale


def usable_light(target: str, values: Tensor, exposure: Tensor | None) -> Tensor:
    """Make a target's channel (N, C, H, W) usable, and expose it if it is radiance. exposure: (N,)."""
    if CHANNELS[target].kind == "radiance" and exposure is not None:
        values = values * per_sequence(exposure)
    light: Tensor = usable(CHANNELS[target], values, BRIGHTEST)
    return light


def demodulated(light: Tensor, albedo: Tensor) -> tuple[Tensor, Tensor]:
    """Divide light (N, 3, H, W) by a usable texture made of an albedo; returns both, (N, 3, H, W) each."""
    texture = divisor(usable_reflectance(albedo))
    return light / texture, texture


def feature(name: str, values: Tensor, exposure: Tensor | None, depth_scale: Tensor) -> Tensor:
    """Turn a channel (N, C, H, W) into features of a scale of about 1, finite whatever its values are.

    Light is exposed and compressed; depths are compared with the depth scale, and so are points; what has no bound,
    such as a vector in pixels, becomes sign(x)·log(1 + |x|); what is unknown (NaN) becomes 0.
    """
    row = CHANNELS[name]
    if row.kind == "depth":
        return _normalised(usable_depth(values), depth_scale)
    if _is_exposed(row) and exposure is not None:
        values = values * per_sequence(exposure)
    made: Tensor = usable(row, values, BRIGHTEST if _is_exposed(row) else ABSOLUTE)
    if row.kind == "point":
        made = made / per_sequence(depth_scale)
    made = made.nan_to_num(0.0)
    if row.kind in ("reflectance", "direction") or row.unit == "1":
        return made
    return compress(made) if row.kind == "radiance" else made.sign() * compress(made.abs())


def _is_exposed(row: Channel) -> bool:
    """Whether a channel's values are light, which has an exposure: radiance, or the luminance of samples."""
    return row.kind == "radiance" or row.unit == "luminance"


def _normalised(depth: Tensor, depth_scale: Tensor) -> Tensor:
    """Depth (N, 1, H, W) mapped to [0, 1] by d / (d + scale): ½ at the scale, 1 for the sky, which is stored as 0."""
    return torch.where(depth > 0, depth / (depth + per_sequence(depth_scale)), 1.0)
