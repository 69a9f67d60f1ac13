"""The kernels that networks apply to a frame, to be looked at.

No network returns them, since they would be most of what an exported graph gives. They are overheard instead, where
`KernelApplication` gets them: whoever runs a denoiser learns its kernels, whatever is wrapped around the network, and
a step takes no longer.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor, nn
from torch.nn.modules.module import register_module_forward_hook

from nte.models.filtering import LEAST_WEIGHT, KernelApplication
from nte.models.kernels import around
from nte.models.prediction import ScaleKernels


class Kernel(NamedTuple):
    """Kernels as they were applied: those of a square sum to 1, or are 0 where there was nothing to read."""

    name: str
    every: int  # so many pixels of the image share one, along each axis
    weights: Tensor  # (K² + further, ⌈H/every⌉, ⌈W/every⌉): a square of taps row by row, then numbers with names
    further: tuple[str, ...] = ()  # names of the numbers after the square


class Application(NamedTuple):
    """What a `KernelApplication` was given for one light, as it has it: padded, and not normalised."""

    light: Tensor
    kernels: list[ScaleKernels]
    history: Tensor | None
    readable: Tensor | None
    prior: Tensor | None = None

    @property
    def number(self) -> int:
        """The number of all weights."""
        tensors = (tensor for scale in self.kernels for tensor in scale)
        return sum(tensor.numel() for tensor in tensors if tensor is not None)

    def applied(self, height: int, width: int) -> list[Kernel]:
        """Compute the kernels of the first image of a batch, finest scale first. height, width: of the frame."""
        found = []
        for level, scale in enumerate(self.kernels):
            if scale.mixing is not None:
                further = ("pixel", *(() if self.prior is None else ("prior",)), "history")
                found.append(Kernel("mixing of 1/2, pixel and history", 1, self._mixing(scale.mixing), further))
            if scale.spatial is not None:
                name = f"kernel at 1/{1 << level}" if level else "kernel"
                blended = scale.alpha if level else None  # at the finest scale it is an extra of the network
                found.append(_spatial(name, 1 << level, scale.spatial, blended))
            if scale.temporal is not None:
                found.append(Kernel("kernel of the history", 1, self._temporal(scale.temporal)))
        return [_cropped(kernel, height, width) for kernel in found]

    def _temporal(self, weights: Tensor) -> Tensor:
        """Leave out the pixels of the history that may not be read, as `apply_masked` does."""
        assert self.readable is not None
        weights = weights * around(self.readable, weights)
        total = weights.sum(1, keepdim=True)
        return torch.where(total > LEAST_WEIGHT, weights / total, 0.0)[0]

    def _mixing(self, mixing: Tensor) -> Tensor:
        weights = F.pixel_shuffle(mixing, 2)
        known = 0.0 if self.readable is None else (self.readable > 0).to(weights.dtype)
        weights = torch.cat([weights[:, :-1], weights[:, -1:] * known], 1)
        return (weights / weights.sum(1, keepdim=True))[0]


@contextmanager
def overheard() -> Iterator[list[Application]]:
    """Collect what networks apply while the block runs, in order: an entry for each light of each network."""
    found: list[Application] = []

    def keep(module: nn.Module, given: tuple[object, ...], _: object) -> None:
        if isinstance(module, KernelApplication):
            found.append(Application._make((*given, None)[: len(Application._fields)]))  # few are given a prior

    handle = register_module_forward_hook(keep)
    try:
        yield found
    finally:
        handle.remove()


def _spatial(name: str, every: int, spatial: Tensor, alpha: Tensor | None) -> Kernel:
    weights = spatial / spatial.sum(1, keepdim=True)
    if alpha is None:
        return Kernel(name, every, weights[0])
    return Kernel(name, every, torch.cat([weights, alpha], 1)[0], ("α",))


def _cropped(kernel: Kernel, height: int, width: int) -> Kernel:
    """Take the padding away, at the bottom and on the right."""
    return kernel._replace(weights=kernel.weights[:, : -(-height // kernel.every), : -(-width // kernel.every)])
