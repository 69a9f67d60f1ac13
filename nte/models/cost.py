"""The cost of a network, measured by running it: parameters, multiply-accumulates per pixel, receptive field."""

import copy
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

import torch
import torch.nn.functional as F
from torch import Tensor
from torch.overrides import TorchFunctionMode
from torch.utils.flop_counter import FlopCounterMode

from nte.frames.channels import CHANNELS, width_of
from nte.models.trainable import TrainableDenoiser
from nte.recurrence import SCALARS

COARSEST = 32  # px: sizes of measured images are multiples of it, as paddings are up to 6 levels
_PHASES = (0, 1, 2, 3, 4, 7, 8, 15, 16, 31)  # px, at the edges of what up to 5 poolings join
_aten = torch.ops.aten
_Shape: TypeAlias = Any  # the counter gives sequences of numbers
_Operator: TypeAlias = Any  # of torch.ops, which have no common type
_RELUS = (torch.relu, torch.relu_, torch.Tensor.relu, torch.Tensor.relu_, F.relu, F.leaky_relu)


@dataclass(frozen=True)
class Cost:
    """What a network costs."""

    parameters: int
    macs: Mapping[str, tuple[float, float]]  # step → multiply-accumulates per pixel: in convolutions, in products
    receptive_field: int  # px: side of the square of this frame's pixels that one pixel of the image depends on

    @property
    def macs_per_pixel(self) -> float:
        """Multiply-accumulates per pixel in all: convolutions, and products of single values, mostly with kernels."""
        return sum(map(sum, self.macs.values()))

    def lines(self) -> list[str]:
        """Describe the cost in lines of text."""
        whole = f"{self.parameters:,} parameters, {self.macs_per_pixel:,.0f} multiply-accumulates per pixel, "
        steps = [
            f"  {name}: {convolved:,.0f} in convolutions, {products:,.0f} in kernels and other products"
            for name, (convolved, products) in self.macs.items()
        ]
        return [f"{whole}receptive field of {self.receptive_field} pixels", *steps]


def cost_of(network: TrainableDenoiser) -> Cost:
    """Measure what a network costs."""
    network = copy.deepcopy(network).cpu().float().eval().requires_grad_(False)
    parameters = sum(parameter.numel() for parameter in network.parameters())
    return Cost(parameters, macs_per_pixel(network), receptive_field(network))


def macs_per_pixel(network: TrainableDenoiser) -> dict[str, tuple[float, float]]:
    """Count multiply-accumulates per pixel of each step (direct child module): in convolutions, in other products.

    Products are those of single values, such as a kernel's weight with a pixel, and 4 for a bilinear fetch. What
    happens between steps counts for the network itself, under the name "rest" if there is any.
    """
    size = (2 * COARSEST, 2 * COARSEST)
    counter = FlopCounterMode(display=False, custom_mapping=dict(_PRODUCTS))
    given, root = _inputs(network, size), type(network).__name__
    with torch.no_grad(), counter:
        network(*given)
    counts = counter.get_flop_counts()
    steps = [name for name, _ in network.named_children()]
    found = {name: _per_pixel(counts.get(f"{root}.{name}", {}), size) for name in steps}
    whole = _per_pixel(counts.get(root, {}), size)
    rest = tuple(total - sum(of[i] for of in found.values()) for i, total in enumerate(whole))
    found["rest"] = rest[0], rest[1]
    return {name: of for name, of in found.items() if sum(of) > 0.5}


def receptive_field(network: TrainableDenoiser, longest: int = 4096) -> int:
    """Measure the side, in pixels, of the square of the current frame that a pixel of the image depends on.

    The network is made linear where it would hide a dependence: average instead of maximum pooling, no ReLU, random
    weights, as trained ones may reach a clamp. Then the gradient of a pixel reaches all pixels that it can depend on.
    As pooling depends on the position, the largest field of ten pixels counts. Measured along x on an image that is
    `COARSEST` high, and wide enough, up to `longest`.
    """
    network = copy.deepcopy(network).requires_grad_(False)
    generator = torch.Generator().manual_seed(0)
    for weights in network.parameters():
        inputs = math.prod(weights.shape[1:])
        weights.copy_(torch.randn(weights.shape, generator=generator) / inputs**0.5)
    wide = 256
    while True:
        found = _reach(network, wide)
        if found < wide // 2 or wide >= longest:
            return found
        wide *= 4


def _reach(network: TrainableDenoiser, width: int) -> int:
    """The receptive field along x on an image of some width."""
    given = _inputs(network, (COARSEST, width))
    images = [x.requires_grad_() for name, x in zip(network.inputs, given, strict=True) if name in CHANNELS]
    with _Linear():
        row = network(*(x + 0 for x in given))[0].sum(1)[0, COARSEST // 2]  # + 0: forward may change them in place
    widest = 0
    if not row.requires_grad:
        return widest
    for phase in _PHASES:
        gradients = torch.autograd.grad(row[width // 2 + phase], images, retain_graph=True, allow_unused=True)
        reached = torch.stack([(g != 0).any(1).any(1)[0] for g in gradients if g is not None]).any(0).nonzero()
        widest = max(widest, int(reached.max() - reached.min()) + 1) if len(reached) else widest
    return widest


class _Linear(TorchFunctionMode):
    """Replaces operators that choose between values by linear ones with the same reach."""

    def __torch_function__(
        self,
        func: _Operator,
        types: object,
        args: tuple[_Operator, ...] = (),
        kwargs: Mapping[str, object] | None = None,
    ) -> _Operator:
        if func in (torch.max_pool2d, F.max_pool2d):
            return F.avg_pool2d(args[0], args[1])
        if func in _RELUS:
            return args[0]
        return func(*args, **dict(kwargs or {}))


def _inputs(network: TrainableDenoiser, size: tuple[int, int]) -> list[Tensor]:
    """Random positive inputs of a batch of 1: the middle of a sequence whose scene stands still."""
    generator = torch.Generator().manual_seed(0)
    shapes = {name: tensor.shape(1, *size) for name, tensor in network.recurrent.items()}
    made = []
    for name in network.inputs:
        shape = shapes.get(name) or (1, width_of(name), *size) if name not in SCALARS else (1,)
        values = torch.rand(shape, generator=generator) * 0.5 + 0.25
        made.append(torch.zeros(shape) if name in ("motion", "reset") or "forward_motion" in name else values)
    return made


def _per_pixel(counts: Mapping[_Operator, int], size: tuple[int, int]) -> tuple[float, float]:
    """(multiply-accumulates in convolutions, other products) per pixel; the counter has two flops for each."""
    products = sum(count for op, count in counts.items() if getattr(op, "_qualified_op_name", "") in _PRODUCT_NAMES)
    pixels = 2 * size[0] * size[1]
    return (sum(counts.values()) - products) / pixels, products / pixels


def _numbers(shape: _Shape) -> int:
    return int(torch.Size(shape).numel())


def _product(*shapes: _Shape, out_shape: _Shape = None, **_: object) -> int:
    return 2 * _numbers(out_shape)


def _bilinear(*shapes: _Shape, out_shape: _Shape = None, **_: object) -> int:
    return 2 * 4 * _numbers(out_shape)


_PRODUCTS: dict[_Operator, Callable[..., int]] = {
    _aten.mul: _product,
    _aten.addcmul: _product,
    _aten.addcmul_: _product,
    _aten.lerp: _product,
    _aten.grid_sampler_2d: _bilinear,
    _aten.upsample_bilinear2d: _bilinear,
}
_PRODUCT_NAMES = {op._qualified_op_name for op in _PRODUCTS}
