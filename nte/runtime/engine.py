"""What runs a graph, as an exported model sees it: ONNX Runtime with any provider, or OpenVINO."""

from collections.abc import Mapping, Sequence
from typing import Any, Protocol, TypeAlias

from nte.frames.clip import Pixels
from nte.runtime.description import Shapes

Value = Any  # a tensor where an engine keeps it: an OrtValue, or an array
Spent: TypeAlias = list[tuple[str, float]]  # a frame's operators as they ran: name in the graph, and milliseconds


class Engine(Protocol):
    """A graph that is ready to run. Several sequences, also on several threads, may share one."""

    inputs: Shapes
    outputs: list[str]

    def keep(self, array: Pixels) -> Value:
        """Copy an array to where the engine computes, to be fed in this frame and the next one."""
        ...

    def run(self, feed: Mapping[str, Value], shown: Sequence[str], kept: Sequence[str]) -> dict[str, Value]:
        """Compute the outputs `shown`, as arrays that belong to the caller, and `kept`, as values to feed again.

        feed: an array or a kept value for each input. No name is in both.
        """
        ...

    def profile(self) -> list[Spent]:
        """End the profile that was asked for, and return what it has of each frame, in their order."""
        ...
