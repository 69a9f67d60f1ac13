"""The state that a network carries from frame to frame: one rule for PyTorch networks and for exported ones.

A network is a function of named arrays: channels (N, C, H, W), SCALARS (N,), and the recurrent tensors that the
previous frame left. The caller keeps these tensors in a NetworkState, fills them with 0 where sequences begin, and
sets `reset`. This module does not import PyTorch.
"""

from collections.abc import Callable, Container, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from nte.denoiser import refuse_other_size
from nte.frames.frame import Array, Frame
from nte.frames.scalars import given_scalars, known_scalars

SCALARS = ("reset", "exposure", "depth_scale")  # (N,), offered to every network, which need not use them
MEASURED = {"exposure": "color", "depth_scale": "depth"}  # scalar → the channel it is measured from if not given
FORWARD = "previous_forward_motion"  # input that is made by scattering `motion` where a frame does not have it
DENOISED = "denoised_"  # before the name of a light component: the output that is that extra, as inputs have the name
Numbers = npt.NDArray[np.float32]


class Recurrent(NamedTuple):
    """A tensor that is carried on: an image (N, components, ⌈H/scale⌉, ⌈W/scale⌉), or numbers (N,) for 0 components.

    It is 0 at first, and ignored after a reset.
    """

    source: str  # name of the output or input of this frame that the next frame gets
    components: int
    scale: int = 1

    def shape(self, batch: int, height: int, width: int) -> tuple[int, ...]:
        """Return the tensor's shape for a batch of frames of this height and width."""
        if self.components == 0:
            return (batch,)
        return batch, self.components, -(-height // self.scale), -(-width // self.scale)


class SequenceScalars(NamedTuple):
    """Exposure and depth scale of each sequence, as NumPy arrays even if the network is a PyTorch module."""

    exposure: Numbers  # (N,), NaN until a frame with light
    depth_scale: Numbers  # (N,), NaN until a frame with a surface

    def begun(self, frame: Frame, reset: Numbers) -> "SequenceScalars":
        """Take the scalars that `frame` gives; measure those of sequences that start with it, or that are unknown.

        reset (N,): 1 where a sequence starts.
        """
        known = self
        starts = [(reset > 0) | np.isnan(carried) for carried in self]
        if np.any(starts):
            own = zip(starts, known_scalars(frame), self, strict=True)
            known = SequenceScalars(*(np.where(start, scalar, carried) for start, scalar, carried in own))
        given = zip(given_scalars(frame), known, strict=True)
        return SequenceScalars(*(carried if scalar is None else scalar for scalar, carried in given))

    def known(self) -> dict[str, Numbers]:
        """Return both scalars by name, with 1 for those that are unknown."""
        return {name: np.nan_to_num(value, nan=1.0) for name, value in self._asdict().items()}


class NetworkState(NamedTuple):
    """The state of a network, in PyTorch or exported, after a frame."""

    tensors: dict[str, Array]  # the recurrent inputs of the next frame
    scalars: SequenceScalars
    size: tuple[int, int, int]  # (batch, height, width)


def begin(
    frame: Frame, state: NetworkState | None, recurrent: Mapping[str, Recurrent], zeros: Callable[..., Array],
    taken: Container[str] = SCALARS,
) -> tuple[NetworkState, Numbers]:  # fmt: skip
    """Prepare the state for denoising a frame, and return it with reset (N,).

    state: None starts a sequence. recurrent: what the network carries, by the name of its input. zeros: a function that
    makes an array of a shape, filled with 0. taken: names of the network's inputs; an exposure that is not among them
    is not measured. Raises NteError if the frame's batch or size differs from those before, and if the frame has
    neither an exposure nor `color` to measure it from.
    """
    size = frame.batch, *frame.size
    if state is None:
        unknown = np.full(frame.batch, np.nan, np.float32)
        reset = np.ones(frame.batch, np.float32)
        state = NetworkState(
            {name: zeros(tensor.shape(*size)) for name, tensor in recurrent.items()},
            SequenceScalars(unknown, unknown),
            size,
        )
    else:
        refuse_other_size(frame, state.size)
        reset = np.zeros(frame.batch, np.float32) if frame.reset is None else _as_numpy(frame.reset)
    if "exposure" not in taken:  # no channel that is seen depends on it, so none has to be there to measure it
        frame = replace(frame, exposure=np.ones(frame.batch, np.float32))
    return state._replace(scalars=state.scalars.begun(frame, reset)), reset


def hand_on(state: NetworkState, recurrent: Mapping[str, Recurrent], made: Mapping[str, Any]) -> NetworkState:
    """Return the state after a frame. made: the frame's outputs and inputs, by name."""
    return state._replace(tensors={name: made[tensor.source] for name, tensor in recurrent.items()})


def _as_numpy(array: Array) -> Numbers:
    return np.asarray(array.detach().cpu() if hasattr(array, "detach") else array, np.float32)
