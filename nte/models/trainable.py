"""The interface of networks: everything that training, export and `nte info` know about one.

A network is one file with a dataclass of its settings and a subclass of TrainableDenoiser. The subclass declares what
the network takes, returns and carries, and has a `forward` on plain tensors; `step` and the exported graph follow from
these declarations.
"""

import inspect
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import ClassVar

import torch
from torch import Tensor, nn

from nte.denoiser import Denoiser, Result, require_extras
from nte.errors import NteError
from nte.frames.channels import CHANNELS
from nte.frames.frame import Frame
from nte.motion.geometric import complete_forward_motion
from nte.recurrence import DENOISED, FORWARD, SCALARS, NetworkState, Recurrent, begin, hand_on


@dataclass
class NetworkConfig:
    """Settings of a network, the section `network` of a training configuration.

    Every kind has a subclass, in which every field has a default.
    """

    kind: str  # a name in nte.models.registry, or package.module:Class

    def check(self) -> None:
        """Raise NteError, naming the key, for values that make no network."""


class TrainableDenoiser(nn.Module, Denoiser):
    """Base class of the networks.

    `forward` has one parameter per input, named after a channel (N, C, H, W) in `needs` or `optional`, a recurrent
    tensor, or one of `reset`, `exposure` and `depth_scale` (N,). A network whose inputs depend on its settings names
    them in `inputs` instead, and its `forward` takes `*tensors` in that order. An optional channel is None where a
    frame lacks it, except previous_forward_motion, which is then scattered from motion and depth, as it is where it is
    NaN everywhere: a network that takes it needs both. `forward` returns a
    tensor for each of `outputs`: the image (N, C, H, W) in the units of the target's channel, the new values of the
    recurrent tensors, and the extras; a light component (`components`) that is an extra is the output denoised_NAME. It
    must sanitise its inputs itself (nte.frames.usable), so that the exported
    graph does so too. A network that takes `exposure` without `color`, or `depth_scale` without `depth`, lists that
    channel as optional: they are measured from it. The exposure may change from frame to frame, so a network that
    carries exposed light carries its exposure too: nte.models.carrying.

    The direct children of the module are its steps: nte bench --steps measures each of them, in PyTorch and in the
    exported graph.
    """

    Config: ClassVar[type[NetworkConfig]]  # class of the network's settings
    recurrent: Mapping[str, Recurrent] = MappingProxyType({})  # tensors that are carried from frame to frame
    conventions: Mapping[str, str] = MappingProxyType({})  # what a runtime must know beyond the table of channels

    def __init__(self, config: NetworkConfig) -> None:
        """Raise NteError for settings that make no network."""
        super().__init__()
        config.check()
        self.config = config

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the inputs of `forward`, in order: its parameters, unless a subclass says otherwise."""
        return tuple(inspect.signature(self.forward).parameters)

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of the outputs of `forward`, in order."""
        made = [tensor.source for tensor in self.recurrent.values() if tensor.source not in (*CHANNELS, *SCALARS)]
        return tuple(dict.fromkeys(["image", *made, *map(self._output_of, self.extras)]))

    def _output_of(self, extra: str) -> str:
        """The output that is an extra: a light component's has another name than the noisy input."""
        return DENOISED + extra if extra in self.components else extra

    def step(
        self, frame: Frame, state: NetworkState | None, extras: tuple[str, ...] = ()
    ) -> tuple[Result, NetworkState]:
        """Denoise one frame on the network's device; state None starts a sequence.

        extras: names out of `self.extras`. The state shares no memory with the frame, nor with the result: a caller may
        fill the same buffers again. Raises NteError for other extras, for a missing channel, and for a batch or size
        that changes within a sequence.
        """
        require_extras(self, extras)
        device = next(self.parameters()).device
        given = frame.torch(device)
        channels: dict[str, Tensor | None] = {name: given[name] for name in self.needs}
        channels |= {name: given.get(name) for name in self.optional}
        taken = self.inputs
        if FORWARD in taken:
            channels[FORWARD] = complete_forward_motion(channels[FORWARD], given["motion"], given["depth"])
        state, reset = begin(frame, state, self.recurrent, lambda shape: torch.zeros(shape, device=device), taken)
        scalars = {name: torch.tensor(value, device=device) for name, value in state.scalars.known().items()}
        inputs = {**channels, **scalars, **state.tensors, "reset": torch.tensor(reset, device=device)}
        made = self(*(inputs[name] for name in taken))
        if not isinstance(made, tuple) or len(made) != len(self.outputs):
            found = f"{len(made)} tensors" if isinstance(made, tuple) else f"a {type(made).__name__}"
            raise NteError(f"{type(self).__name__}.forward gives {found}, expected a tuple: {', '.join(self.outputs)}")
        outputs = dict(zip(self.outputs, made, strict=True))
        result = Result(outputs["image"], {name: outputs[self._output_of(name)] for name in extras})
        callers = _memory(*(given[name] for name in given.channels), result.image, *result.extras.values())
        carried = {tensor.source for tensor in self.recurrent.values()}
        own = {
            name: tensor.clone() if _memory(tensor) & callers else tensor
            for name, tensor in (channels | scalars | outputs).items()
            if name in carried and tensor is not None
        }
        return result.like(frame), hand_on(state, self.recurrent, own)


def _memory(*tensors: Tensor) -> set[int]:
    """The addresses of the memory that tensors lie in; views of one tensor share theirs."""
    return {tensor.untyped_storage().data_ptr() for tensor in tensors}
