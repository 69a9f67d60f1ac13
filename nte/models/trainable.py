"""What a network is to the rest of nte: all that training, export and `nte info` know of one.

A network is a file: a dataclass with its choices, and a subclass of TrainableDenoiser that says what it takes, gives
and carries, with a `forward` on plain tensors. What `step` does, and what the exported graph is, follows from these.
"""

import inspect
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import ClassVar

import torch
from torch import Tensor, nn

from nte.denoiser import Denoiser, Result, check_extras
from nte.errors import NteError
from nte.frames.channels import CHANNELS
from nte.frames.frame import Frame
from nte.motion.geometric import scatter_forward_motion
from nte.recurrence import FORWARD, NetworkState, Recurrent, begin, hand_on


@dataclass
class NetworkConfig:
    """The choices of a network, `network` in a training configuration. Every kind has a subclass, all with defaults."""

    kind: str  # a name in nte.models.registry, or package.module:Class

    def check(self) -> None:
        """Raise NteError, naming the key, for values that make no network."""


class TrainableDenoiser(nn.Module, Denoiser):
    """Base of the networks.

    `forward` has a parameter for each of its inputs, by the name of a channel that is in `needs` or `optional`
    (N, C, H, W), of a recurrent tensor, or `reset`, `exposure` or `depth_scale` (N,). An optional channel is None where
    a frame does not have it, but previous_forward_motion is always there. `forward` returns a tensor for each of
    `outputs`: the image (N, C, H, W) in the units of the target's channel, what the recurrent tensors become, and the
    extras. It must make its inputs usable itself (nte.frames.usable), so that the exported graph does it too.
    """

    Config: ClassVar[type[NetworkConfig]]  # of its choices
    recurrent: Mapping[str, Recurrent] = MappingProxyType({})  # what it carries from frame to frame
    conventions: Mapping[str, str] = MappingProxyType({})  # what a runtime must know beyond the table of channels

    def __init__(self, config: NetworkConfig) -> None:
        """Raise NteError for choices that make no network."""
        super().__init__()
        config.check()
        self.config = config

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of what `forward` takes, in order."""
        return tuple(inspect.signature(self.forward).parameters)

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of what `forward` gives, in order."""
        made = [tensor.source for tensor in self.recurrent.values() if tensor.source not in CHANNELS]
        return tuple(dict.fromkeys(["image", *made, *self.extras]))

    def step(
        self, frame: Frame, state: NetworkState | None, extras: tuple[str, ...] = ()
    ) -> tuple[Result, NetworkState]:
        """Denoise one frame; None starts a sequence. Raises NteError for extras that it does not have, for a channel
        that is missing, and for a size that changes within a sequence."""
        check_extras(self, extras)
        device = next(self.parameters()).device
        given = frame.torch(device)
        channels: dict[str, Tensor | None] = {name: given[name] for name in self.needs}
        channels |= {name: given.get(name) for name in self.optional}
        if FORWARD in self.inputs and channels.get(FORWARD) is None:
            channels[FORWARD] = scatter_forward_motion(given["motion"], given["depth"])
        state, reset = begin(frame, state, self.recurrent, lambda shape: torch.zeros(shape, device=device))
        scalars = {name: torch.tensor(value, device=device) for name, value in state.scalars.known().items()}
        inputs = {**channels, **scalars, **state.tensors, "reset": torch.tensor(reset, device=device)}
        made = self(**{name: inputs[name] for name in self.inputs})
        if not isinstance(made, tuple) or len(made) != len(self.outputs):
            found = f"{len(made)} tensors" if isinstance(made, tuple) else f"a {type(made).__name__}"
            raise NteError(f"{type(self).__name__}.forward gives {found}, expected a tuple: {', '.join(self.outputs)}")
        outputs = dict(zip(self.outputs, made, strict=True))
        result = Result(outputs["image"], {name: outputs[name] for name in extras}).like(frame)
        return result, hand_on(state, self.recurrent, channels | outputs)
