"""One frame of a sequence: named channels, all NumPy or all PyTorch."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from nte.errors import NteError, needs_extra

if TYPE_CHECKING:
    import torch

Array: TypeAlias = Any  # a NumPy array or a PyTorch tensor; base code uses only operations that both have
About: TypeAlias = dict[str, Any]  # fields of a Frame, by name, that are known before the frame is made


@dataclass(frozen=True)
class Frame:
    """Channels of one frame as (N, C, H, W) arrays, all NumPy or all PyTorch, with its scalars and camera.

    exposure, depth_scale, shutter and reset are (N,). view and projection are (N, 4, 4) for column vectors, world →
    view → [0, 1]² with y down. exposure and depth_scale hold for this frame and those after it, until one gives others;
    None in the first frame means that they are estimated from it. shutter is the open share of the frame that
    `shutter_motion` spans, in (0, 1]; None means 1. reset is above 0 for batch elements that start a new sequence.
    clean_guides tells whether albedo and normal are free of noise and antialiased, each the mean over its pixel; None
    means unknown, and they count as noisy.

    Raises NteError if an array is not (N, C, H, W), if channels differ in batch or size, and if NumPy and PyTorch are
    mixed. `frame[name]` raises NteError for a channel that is missing.

    >>> frame = nte.Frame({"color": np.zeros((1, 3, 24, 32), np.float32)}, index=7)
    >>> frame.size, "depth" in frame
    ((24, 32), False)
    """

    channels: Mapping[str, Array]
    index: int = 0
    exposure: Array | None = None
    depth_scale: Array | None = None
    shutter: Array | None = None
    reset: Array | None = None
    view: Array | None = None
    projection: Array | None = None
    clean_guides: bool | None = None

    def __post_init__(self) -> None:
        shapes = {name: tuple(getattr(values, "shape", ())) for name, values in self.channels.items()}
        wrong = [f"{name} {shape}" for name, shape in shapes.items() if len(shape) != 4]
        if wrong:
            raise NteError(f"frame {self.index}: {wrong[0]}: expected an array (N, C, H, W)")
        if len({(shape[0], *shape[2:]) for shape in shapes.values()}) > 1:
            listed = ", ".join(f"{name} {shape}" for name, shape in shapes.items())
            raise NteError(f"frame {self.index}: channels differ in batch or size: {listed}")
        if len({isinstance(values, np.ndarray) for values in self.channels.values()}) > 1:
            listed = ", ".join(f"{name} {type(values).__name__}" for name, values in self.channels.items())
            raise NteError(f"frame {self.index}: channels must be all NumPy or all PyTorch: {listed}")

    def __getitem__(self, name: str) -> Array:
        try:
            return self.channels[name]
        except KeyError:
            have = ", ".join(self.channels) or "none"
            raise NteError(f"frame {self.index}: channel '{name}' is missing; it has {have}") from None

    def __contains__(self, name: object) -> bool:
        return name in self.channels

    def get(self, name: str) -> Array:
        """Return the channel (N, C, H, W), or None if the frame does not have it."""
        return self.channels.get(name)

    @property
    def size(self) -> tuple[int, int]:
        """(height, width) in pixels."""
        shape = self._any().shape
        return int(shape[2]), int(shape[3])

    @property
    def batch(self) -> int:
        """N, the number of sequences in the batch."""
        return int(self._any().shape[0])

    @property
    def hit(self) -> Array:
        """Bool mask (N, 1, H, W), true where a surface is seen; a miss (sky) has depth 0."""
        return self["depth"] > 0

    def with_channels(self, **channels: Array) -> Frame:
        """Return a copy of the frame with channels added or replaced; arrays are shared."""
        return replace(self, channels={**self.channels, **channels})

    def numpy(self) -> Frame:
        """Return the frame with NumPy arrays; the frame itself if it has them already."""
        if isinstance(self._any(), np.ndarray):
            return self
        return self._map(lambda a: np.asarray(a.detach().cpu() if hasattr(a, "detach") else a))

    def torch(self, device: torch.device | str | None = None) -> Frame:
        """Return the frame with float32 PyTorch tensors on `device`.

        None leaves tensors on their device and puts NumPy arrays on the CPU. Raises NteError if PyTorch is missing.
        """
        try:
            import torch
        except ImportError as error:
            raise needs_extra("train", "this denoiser", error) from error

        def convert(array: Array) -> Array:
            # PyTorch refuses flipped views and big-endian data, and warns about read-only arrays.
            plain = np.require(array, np.float32, ["C", "W"]) if isinstance(array, np.ndarray) else array
            return torch.as_tensor(plain, dtype=torch.float32, device=device)

        return self._map(convert)

    def _any(self) -> Array:
        for values in self.channels.values():
            return values
        raise NteError(f"frame {self.index}: it has no channels")

    def _map(self, convert: Callable[[Array], Array]) -> Frame:
        changed: About = {"channels": {name: convert(array) for name, array in self.channels.items()}}
        for name in ("exposure", "depth_scale", "shutter", "reset", "view", "projection"):
            value = getattr(self, name)
            changed[name] = None if value is None else convert(value)
        return replace(self, **changed)
