"""The paper's network: multi-scale and temporal kernel prediction with dual motion vectors.

Zeng et al., «Neural Temporal Denoising for Indirect Illumination». Whatever the text leaves open is a setting, which
`TemporalConfig` documents. The steps are modules of their own, of which other networks can be put together:
nte.models.reading, reprojection, prediction and filtering.
"""

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor, nn

from nte.color import luminance
from nte.errors import NteError
from nte.models.carrying import Carrying, compressed_moments, scaled
from nte.models.filtering import Blending, KernelApplication, Mixing, padded
from nte.models.prediction import TAPS, KernelConfig, KernelHeads, Memory
from nte.models.reading import LightConfig, Reader, Seen
from nte.models.reprojection import Reprojected, Reprojection, Statistics, accumulate
from nte.models.trainable import TrainableDenoiser
from nte.models.unet import UNet, xavier
from nte.recurrence import FORWARD, Recurrent

_PRIOR_TAP = TAPS - 1  # the last before history
PREFERENCE = 3.0  # of the prior at the start, as the logarithm of its weight: e³ of 31, so that training refines it


@dataclass
class TemporalConfig(LightConfig, KernelConfig):
    """Settings of the network; the defaults are the paper's, where it states them."""

    kind: str = "temporal"
    temporal: bool = True  # a temporal kernel filters the warped previous output, and α blends it in
    feed_warped: bool = True  # the warped previous output is an input of the network
    feed_masks: bool = False  # the history's validity and the disocclusion mask are inputs too (not in the paper)
    moments: bool = False  # mean and deviation over time of the noisy luminance are inputs too (not in the paper)
    history_length: bool = False  # 1 / number of frames in which the surface was seen is an input (not in the paper)
    finest: str = "kernels"  # mixing: a few weights instead of kernels at full resolution (not in the paper)
    prior: str = ""  # a denoiser, such as oidn:quality=fast, whose image is seen and mixed too (not in the paper)
    feature_history: int = 0  # number of decoder features that are carried, warped and fed (not in the paper)

    def check(self) -> None:
        """Raise NteError, naming the key, for values that make no network."""
        super().check()
        if self.finest not in ("kernels", "mixing"):
            raise NteError(f"network.finest is '{self.finest}', expected kernels or mixing")
        if self.finest == "mixing" and not self.temporal:
            raise NteError("network.finest is mixing, which has a weight for the history: set network.temporal to true")
        if self.finest == "mixing" and (self.front != 2 or self.scales < 2):
            found = f"network.front is {self.front} and network.scales is {self.scales}"
            raise NteError(f"{found}, expected a front of 2 and at least 2 scales, as network.finest is mixing")
        if self.prior and (self.finest != "mixing" or self.target == "visibility"):
            found = f"network.finest is {self.finest} and network.target is {self.target}"
            raise NteError(f"{found}, expected mixing and a radiance, as network.prior is {self.prior}")
        if self.feature_history < 0:
            raise NteError(f"network.feature_history is {self.feature_history}, expected a number of features from 0")

    @property
    def carries(self) -> dict[str, int]:
        """Images that are carried and warped, with their numbers of components, except the history itself."""
        statistics = {"moments": 2, "length": 1} if self.moments or self.history_length else {}
        return statistics | ({"features": self.feature_history} if self.feature_history else {})


class Past(NamedTuple):
    """What a network knows of the frames before, on the pixels of this one."""

    features: list[Tensor]  # that the network sees
    history: Tensor | None  # (N, C, H, W): the previous output; the noisy light where it is not valid
    readable: Tensor  # (N, 1, H, W): 1 where the temporal kernel may read the history, else 0
    statistics: Statistics | None


class TemporalDenoiser(TrainableDenoiser):
    """A recurrent, kernel-predicting denoiser of one kind of light.

    The state holds the last output, exposed, and demodulated if so configured, the last depth and exposure, and what
    the settings `moments`, `history_length` and `feature_history` ask for.
    """

    Config = TemporalConfig
    config: TemporalConfig
    inputs: tuple[str, ...] = ()  # depends on the settings

    def __init__(self, config: TemporalConfig) -> None:
        super().__init__(config)
        self.reading = Reader(config.target, tuple(config.inputs), config.demodulate, bool(config.prior))
        self.prior = config.prior
        self.reprojection = Reprojection(config.motion == "dual")
        components, vectors = self.reading.components, self.reprojection.vectors
        self.target = config.target
        self.needs: tuple[str, ...] = tuple(dict.fromkeys([*self.reading.needs, "motion"]))
        self.optional: tuple[str, ...] = (*vectors, *self.reading.measured)
        self.extras = ("disoccluded", "valid", *(("alpha",) if config.temporal else ()))
        remembers = config.temporal or config.feed_warped
        self.carried = ({"history": components} if remembers else {}) | config.carries
        exposed = {"history": scaled, "moments": compressed_moments} if self.reading.is_radiance else {}
        self.carrying = Carrying(self.carried, {name: exposed[name] for name in exposed if name in self.carried})
        self.recurrent = {name: Recurrent(f"next_{name}", width) for name, width in self.carried.items()}
        self.recurrent |= self.reprojection.recurrent | self.carrying.recurrent
        self.inputs = (*self.needs, *vectors, "reset", *self.reading.scalars, *self.recurrent)

        width = self.reading.width + components * config.feed_warped + 2 * config.feed_masks
        width += 2 * config.moments + config.history_length + config.feature_history
        self.prediction = Prediction(width, config)
        self.kernels = KernelApplication()
        most = None if self.reading.is_radiance else 1.0
        blend = Mixing if config.finest == "mixing" else Blending
        self.blending = blend(config.pooling, most)
        self.apply(xavier)
        if config.prior:
            self.prediction.heads.prefer(_PRIOR_TAP, PREFERENCE)

    def forward(self, *tensors: Tensor) -> tuple[Tensor, ...]:
        """Denoise one frame of plain tensors, with all conventions inside: this is the exported graph.

        tensors: `inputs`, in order: images (N, C, H, W) of any size from 16; reset, exposure and depth_scale (N,).
        Where reset is 1 the history is ignored, and the noisy image takes the place of the warped previous one.
        """
        given = dict(zip(self.inputs, tensors, strict=True))
        seen: Seen = self.reading(given)
        moved: Reprojected = self.reprojection(
            given["motion"], given.get(FORWARD), seen.depth, given.get("previous_depth"), given["reset"],
            self.carrying(given),
        )  # fmt: skip
        past = self._past(seen, moved)

        height, width = seen.light.shape[-2:]
        multiple = self.config.multiple
        features = padded(torch.cat([seen.features, *past.features], 1), multiple)
        light, readable = padded(seen.light, multiple), padded(past.readable, multiple)
        history = None if past.history is None else padded(past.history, multiple)
        kernels, remembered = self.prediction(features)
        prior = None if seen.prior is None else padded(seen.prior, multiple)
        filtered, alpha = self.blending(self.kernels(light, kernels, history, readable, prior), kernels)

        filtered = filtered[..., :height, :width]
        made = {"image": self.reading.image(filtered, seen), "next_history": filtered}
        made |= {"disoccluded": moved.disoccluded.float(), "valid": moved.valid.float()}
        if past.statistics is not None:
            made |= {"next_moments": past.statistics.moments, "next_length": past.statistics.length}
        if remembered is not None:
            made["next_features"] = remembered[..., :height, :width]
        if alpha is not None:
            made["alpha"] = alpha[..., :height, :width]
        return tuple(made[name] for name in self.outputs)

    def _past(self, seen: Seen, moved: Reprojected) -> Past:
        """Read the reprojected images: what the network sees of the past, and what its temporal kernel filters."""
        config, valid = self.config, moved.valid
        parts: dict[str, Tensor] = {}
        if moved.carried is not None:
            images = torch.split(moved.carried, list(self.carried.values()), 1)
            parts = dict(zip(self.carried, images, strict=True))
        history, statistics = parts.get("history"), None
        features = []
        if history is not None:
            history = torch.where(valid, history, seen.light)
        if config.feed_warped and history is not None:
            features.append(self.reading.compressed(history))
        if config.feed_masks:
            features += [valid.to(seen.light.dtype), moved.disoccluded.to(seen.light.dtype)]
        if "moments" in parts:
            value = luminance(seen.light) if self.reading.components == 3 else seen.light
            statistics = accumulate(self.reading.compressed(value), parts["moments"], parts["length"], valid)
            wanted = [0, 1] * config.moments + [2] * config.history_length
            features.append(statistics.features()[:, wanted])
        if "features" in parts:
            features.append(torch.where(valid, parts["features"], 0.0))
        # On the first frame the noisy image replaces the warped one everywhere, as in the paper.
        readable = (valid | ~moved.continues).to(seen.light.dtype)
        return Past(features, history if config.temporal else None, readable, statistics)


class Prediction(nn.Module):
    """The step that predicts kernels, and features to remember if so configured, from the features of a frame."""

    def __init__(self, inputs: int, config: TemporalConfig) -> None:
        super().__init__()
        self.trunk = UNet(inputs, config.channels, config.front)
        self.heads = KernelHeads(
            config.channels, config.front, config.scales, config.kernel_size, config.head_size, config.temporal,
            TAPS + bool(config.prior) if config.finest == "mixing" else 0,
        )  # fmt: skip
        remembered = config.feature_history
        self.memory = Memory(config.channels[0], config.front, remembered) if remembered else None

    def forward(self, features: Tensor) -> tuple[list[Tensor], Tensor | None]:
        """Return the kernels of each scale, finest first, and the features (N, feature_history, H, W) to remember."""
        levels = self.trunk(features)
        return self.heads(levels), None if self.memory is None else self.memory(levels[0])
