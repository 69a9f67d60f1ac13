"""A network for all light components at once: one trunk, and small heads with kernels of their own for each light.

color = emission + direct·visibility + glossy + indirect. Emission and direct light have no noise, so they are added as
they are; visibility, glossy and indirect light are filtered, each with a history of its own.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import torch
from torch import Tensor, nn

from nte.color import per_sequence
from nte.frames.channels import CHANNELS, COMPONENTS, TEXTURES, width_of
from nte.frames.usable import BRIGHTEST, usable_depth, usable_radiance
from nte.models.carrying import Carrying, scaled
from nte.models.filtering import Blending, Filtered, KernelApplication, padded
from nte.models.kernels import Downsample
from nte.models.prediction import KernelConfig, KernelHeads, ScaleKernels
from nte.models.reading import check_inputs, demodulated, feature, usable_light
from nte.models.reprojection import Reprojection
from nte.models.trainable import TrainableDenoiser
from nte.models.unet import UNet, xavier
from nte.recurrence import FORWARD, Recurrent

Lights = dict[str, Tensor]  # component → image (N, C, H, W)
GUIDES = ("albedo", "diffuse_albedo", "normal", "depth", "direct")
WIDTHS = [width_of(name) for name in COMPONENTS]


@dataclass
class SeparatedConfig(KernelConfig):
    """Settings of the network."""

    kind: str = "separated"
    head_size: int = 1
    downsample: str = "mean"
    demodulate: bool = True  # filter indirect light without its texture
    inputs: list[str] = field(default_factory=list)  # further channels that the network sees, such as roughness

    def check(self) -> None:
        """Raise NteError, naming the key, for values that make no network."""
        super().check()
        check_inputs(self.inputs, (*COMPONENTS, *GUIDES))


class SeenLights(NamedTuple):
    """What the network sees of a frame."""

    lights: Lights  # usable, exposed, linear; indirect light without its texture if so configured
    features: Tensor  # (N, F, H, W)
    depth: Tensor  # (N, 1, H, W) usable
    texture: Tensor | None  # (N, 3, H, W) of indirect light


class SeparatedDenoiser(TrainableDenoiser):
    """A recurrent denoiser of `color` that filters visibility, glossy and indirect light separately.

    Extras: the filtered components by their names, in the units of their channels. The state holds the last outputs of
    all three, exposed, and the last depth and exposure.
    """

    Config = SeparatedConfig
    config: SeparatedConfig
    components = COMPONENTS
    extras = ("disoccluded", "valid", *COMPONENTS)
    inputs: tuple[str, ...] = ()  # depends on the settings

    def __init__(self, config: SeparatedConfig) -> None:
        super().__init__(config)
        self.reading = LightsReader(tuple(config.inputs), config.demodulate)
        self.reprojection = Reprojection(config.motion == "dual")
        vectors = self.reprojection.vectors
        self.needs: tuple[str, ...] = tuple(dict.fromkeys([*COMPONENTS, *GUIDES, "emission", "motion", *config.inputs]))
        self.optional: tuple[str, ...] = (*vectors, *(() if "color" in self.needs else ("color",)))
        self.recurrent = {f"{name}_history": Recurrent(f"next_{name}", width_of(name)) for name in COMPONENTS}
        lights = [f"{name}_history" for name in COMPONENTS if CHANNELS[name].kind == "radiance"]
        self.carrying = Carrying(self.recurrent, dict.fromkeys(lights, scaled))
        self.recurrent |= self.reprojection.recurrent | self.carrying.recurrent
        self.inputs = (*self.needs, *vectors, "reset", "exposure", "depth_scale", *self.recurrent)
        self.prediction = LightsPrediction(self.reading.width + sum(WIDTHS), config)
        self.kernels = LightsKernels()
        self.blending = LightsBlending(config.pooling)
        self.apply(xavier)

    def forward(self, *tensors: Tensor) -> tuple[Tensor, ...]:
        """Denoise one frame of plain tensors: `inputs`, in order → the image, the next histories, and the extras.

        Images (N, C, H, W) of any size from 16; reset, exposure and depth_scale (N,). Where reset is 1 the histories
        are ignored, and the noisy light takes the place of the warped previous one.
        """
        given = dict(zip(self.inputs, tensors, strict=True))
        seen: SeenLights = self.reading(given)
        moved = self.reprojection(
            given["motion"], given.get(FORWARD), seen.depth, given.get("previous_depth"), given["reset"],
            self.carrying(given),
        )  # fmt: skip
        noisy = torch.cat(list(seen.lights.values()), 1)
        warped = torch.where(moved.valid, moved.carried, noisy)
        readable = (moved.valid | ~moved.continues).to(noisy.dtype)

        height, width = noisy.shape[-2:]
        multiple = self.config.multiple
        features = torch.cat([seen.features, *(compressed(n, x) for n, x in parts(warped).items())], 1)
        kernels = self.prediction(padded(features, multiple))
        noisy, warped, readable = (padded(x, multiple) for x in (noisy, warped, readable))
        filtered = self.kernels(parts(noisy), kernels, parts(warped), readable)
        lights = {name: x[..., :height, :width] for name, x in self.blending(filtered, kernels).items()}

        made = {f"next_{name}": light for name, light in lights.items()}
        scale = per_sequence(given["exposure"])
        if seen.texture is not None:
            lights["indirect"] = lights["indirect"] * seen.texture
        direct, emission = (usable_radiance(given[name] * scale, BRIGHTEST) for name in ("direct", "emission"))
        image = emission + direct * lights["visibility"] + lights["glossy"] + lights["indirect"]
        made |= {"image": image / scale, "denoised_visibility": lights["visibility"]}
        made |= {f"denoised_{name}": lights[name] / scale for name in ("glossy", "indirect")}
        made |= {"disoccluded": moved.disoccluded.float(), "valid": moved.valid.float()}
        return tuple(made[name] for name in self.outputs)


class LightsReader(nn.Module):
    """The step that turns a frame's channels into three lights and features."""

    def __init__(self, inputs: tuple[str, ...], demodulate: bool) -> None:
        super().__init__()
        self.seen, self.demodulate = (*GUIDES, *inputs), demodulate
        self.width = sum(map(width_of, (*COMPONENTS, *self.seen)))

    def forward(self, given: Mapping[str, Tensor]) -> SeenLights:
        """Read the channels and the scalars (N,) out of `given`."""
        exposure, depth_scale = given["exposure"], given["depth_scale"]
        lights = {name: usable_light(name, given[name], exposure) for name in COMPONENTS}
        texture = None
        if self.demodulate:
            lights["indirect"], texture = demodulated(lights["indirect"], given[TEXTURES["indirect"]])
        features = [compressed(name, light) for name, light in lights.items()]
        features += [feature(name, given[name], exposure, depth_scale) for name in self.seen]
        return SeenLights(lights, torch.cat(features, 1), usable_depth(given["depth"]), texture)


class LightsPrediction(nn.Module):
    """The step that predicts the kernels of each light from the features of the whole frame."""

    def __init__(self, inputs: int, config: SeparatedConfig) -> None:
        super().__init__()
        self.trunk = UNet(inputs, config.channels, config.front)
        self.heads = nn.ModuleDict(
            {
                name: KernelHeads(
                    config.channels, config.front, config.scales, config.kernel_size, config.head_size, temporal=True
                )
                for name in COMPONENTS
            }
        )

    def forward(self, features: Tensor) -> dict[str, list[ScaleKernels]]:
        """Return the kernels of each scale, finest first, for each light."""
        levels = self.trunk(features)
        return {name: head(levels) for name, head in self.heads.items()}


class LightsKernels(nn.Module):
    """The step that applies the kernels of each light: as `KernelApplication`, with 7 components in all."""

    def __init__(self) -> None:
        super().__init__()
        self.each = KernelApplication()

    def forward(
        self, lights: Lights, kernels: Mapping[str, list[ScaleKernels]], histories: Lights, readable: Tensor
    ) -> dict[str, Filtered]:
        """Filter each light and its history. readable (N, 1, H, W): 1 where histories may be read, else 0."""
        return {name: self.each(lights[name], kernels[name], histories[name], readable) for name in lights}


class LightsBlending(nn.Module):
    """The step that combines the scales of each light, and blends it with its history."""

    def __init__(self, downsample: Downsample) -> None:
        super().__init__()
        limits = {name: None if CHANNELS[name].kind == "radiance" else 1.0 for name in COMPONENTS}
        self.each = nn.ModuleDict({name: Blending(downsample, most) for name, most in limits.items()})

    def forward(self, filtered: Mapping[str, Filtered], kernels: Mapping[str, list[ScaleKernels]]) -> Lights:
        """Return each light (N, C, H, W)."""
        return {name: blend(filtered[name], kernels[name])[0] for name, blend in self.each.items()}


def parts(image: Tensor) -> Lights:
    """Split an image (N, 7, H, W) into the components that it was concatenated of."""
    return dict(zip(COMPONENTS, torch.split(image, WIDTHS, 1), strict=True))


def compressed(name: str, light: Tensor) -> Tensor:
    """Compress a light as features have it; visibility stays as it is."""
    return torch.log1p(light) if CHANNELS[name].kind == "radiance" else light
