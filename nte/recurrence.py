"""What a network carries from frame to frame: one rule for PyTorch and for an exported graph without it.

A network is a function of named arrays: channels (N, C, H, W), SCALARS (N,), and the recurrent tensors that the frame
before has left. Its caller keeps these in a NetworkState, fills them with 0 where sequences begin, and sets `reset`.
"""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from nte.denoiser import refuse_other_size
from nte.frames.frame import Array, Frame
from nte.frames.scalars import known_scalars

SCALARS = ("reset", "exposure", "depth_scale")  # inputs (N,) of every network; one need not use them
FORWARD = "previous_forward_motion"  # the input that is made, by scattering `motion`, where a frame does not have it
Numbers = npt.NDArray[np.float32]


class Recurrent(NamedTuple):
    """A tensor (N, components, ⌈H/scale⌉, ⌈W/scale⌉) that a network hands on; 0 at first, ignored after a reset."""

    source: str  # the output, or the channel, of a frame that the next frame gets
    components: int
    scale: int = 1

    def shape(self, batch: int, height: int, width: int) -> tuple[int, int, int, int]:
        """Of a batch of frames of this size."""
        return batch, self.components, -(-height // self.scale), -(-width // self.scale)


class SequenceScalars(NamedTuple):
    """Exposure and depth scale of sequences, in NumPy also where the network is PyTorch's."""

    exposure: Numbers  # (N,), NaN until there was light
    depth_scale: Numbers  # (N,), NaN until a surface was seen

    def begun(self, frame: Frame, reset: Numbers) -> "SequenceScalars":
        """With those of sequences that start with this frame, where reset (N,) is 1, and of those that had none yet."""
        starts = [(reset > 0) | np.isnan(carried) for carried in self]
        if not np.any(starts):
            return self
        own = zip(starts, known_scalars(frame), self, strict=True)
        return SequenceScalars(*(np.where(start, scalar, carried) for start, scalar, carried in own))

    def known(self) -> dict[str, Numbers]:
        """Both by name, 1 where they are unknown."""
        return {name: np.nan_to_num(value, nan=1.0) for name, value in self._asdict().items()}


class NetworkState(NamedTuple):
    """The state of a network or of an exported one, after a frame."""

    tensors: dict[str, Array]  # the recurrent inputs of the next frame
    scalars: SequenceScalars
    size: tuple[int, int, int]  # (batch, height, width)


def begin(
    frame: Frame, state: NetworkState | None, recurrent: Mapping[str, Recurrent], zeros: Callable[..., Array]
) -> tuple[NetworkState, Numbers]:
    """The state with which a frame is denoised, and reset (N,); `zeros` makes an array of a shape.

    Raises NteError where the frame has another batch or size than those before.
    """
    size = frame.batch, *frame.size
    if state is None:
        unknown = np.full(frame.batch, np.nan, np.float32)
        reset = np.ones(frame.batch, np.float32)
        state = NetworkState(
            {name: zeros(tensor.shape(*size)) for name, tensor in recurrent.items()},
            SequenceScalars(unknown, unknown), size,
        )  # fmt: skip
    else:
        refuse_other_size(frame, state.size)
        reset = np.zeros(frame.batch, np.float32) if frame.reset is None else _as_numpy(frame.reset)
    return state._replace(scalars=state.scalars.begun(frame, reset)), reset


def hand_on(state: NetworkState, recurrent: Mapping[str, Recurrent], made: Mapping[str, Any]) -> NetworkState:
    """The state after a frame; made: its outputs and its channels, by name."""
    return state._replace(tensors={name: made[tensor.source] for name, tensor in recurrent.items()})


def _as_numpy(array: Array) -> Numbers:
    return np.asarray(array.detach().cpu() if hasattr(array, "detach") else array, np.float32)
