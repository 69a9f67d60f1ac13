"""What every operator on images must do, whatever it computes: one table of operators, the same questions to each."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import pytest
import torch
from torch import Tensor

from nte.color import compress, demodulate, display, divisor, luminance, remodulate
from nte.errors import NteError
from nte.filters.atrous import atrous_step
from nte.filters.bilateral import joint_bilateral, make_edges, make_guide
from nte.filters.blocks import clamp_history, clip_history, neighbourhood_moments
from nte.models.kernels import apply_kernels, combine_scales
from nte.motion.box import box_mean
from nte.motion.catmull_rom import warp_catmull_rom
from nte.motion.geometric import dual_motion, scatter_forward_motion, traditional_motion
from nte.motion.warp import fetch_nearest, pixel_centres, warp

Outputs = tuple[Tensor, ...]
N, H, W = 2, 6, 8


class Operator(NamedTuple):
    """A function of images, the channels of each argument, and which of the questions it is asked."""

    call: Callable[..., Outputs]
    channels: Sequence[int]
    returns: Sequence[int]  # channels of each result
    trained: Sequence[int] = ()  # the arguments that gradients flow into
    coarse: Sequence[int] = ()  # the arguments of half the size
    traced: bool = True  # as one graph, without a break


def alike(p: Sequence[Tensor], q: Sequence[Tensor], distance: float) -> tuple[Tensor, Tensor]:
    """The edge-stopping weight of two pixels by one guide."""
    weight = torch.exp(-(p[0] - q[0]).abs() / distance)
    return weight, weight


def bilateral(values: Tensor, normal: Tensor, depth: Tensor, roughness: Tensor) -> Outputs:
    return (joint_bilateral(values, make_edges(make_guide(normal, depth.abs() + 1, roughness), 2), 2, 1.5),)


def in_the_box(clip: Callable[..., Tensor]) -> Callable[[Tensor, Tensor], Outputs]:
    return lambda history, image: (clip(history, neighbourhood_moments(image)),)


def one(function: Callable[..., Tensor]) -> Callable[..., Outputs]:
    return lambda *images: (function(*images),)


OPERATORS = {
    "warp": Operator(warp, (3, 2), (3, 1), (0,)),
    "warp_catmull_rom": Operator(warp_catmull_rom, (3, 2), (3, 1), (0,)),
    "fetch_nearest": Operator(lambda i, m: (fetch_nearest(i, pixel_centres(i) + m),), (3, 2), (3,)),
    "traditional_motion": Operator(traditional_motion, (2,), (2, 1, 1)),
    "dual_motion": Operator(dual_motion, (2, 2), (2, 1, 1)),
    "dual_motion with depth": Operator(dual_motion, (2, 2, 1, 1), (2, 1, 1)),
    "scatter_forward_motion": Operator(one(scatter_forward_motion), (2, 1), (2,)),
    "luminance": Operator(one(luminance), (3,), (1,), (0,)),
    "compress": Operator(lambda x: (compress(x.abs()),), (3,), (3,), (0,)),
    "display": Operator(lambda x: (display(x, x.new_tensor([2.0]).expand(len(x))),), (3,), (3,), (0,)),
    "demodulate": Operator(one(demodulate), (3, 3), (3,), (0,)),
    "remodulate": Operator(one(remodulate), (3, 3), (3,), (0,)),
    "divisor": Operator(one(divisor), (3,), (3,)),
    "apply_kernels": Operator(one(apply_kernels), (3, 9), (3,), (0, 1)),
    "combine_scales": Operator(
        lambda *images: (combine_scales(*images, "mean"),), (3, 3, 1), (3,), (0, 1, 2), coarse=(1, 2)
    ),
    "box_mean": Operator(lambda x: (box_mean(x, 3),), (3,), (3,)),
    "clamp_history": Operator(in_the_box(clamp_history), (3, 3), (3,), (0,)),
    "clip_history": Operator(in_the_box(clip_history), (3, 3), (3,), (0,)),
    "atrous_step": Operator(lambda v, g: (atrous_step(v, 2, alike, [g]).values,), (3, 1), (3,), traced=False),
    "atrous_step with variance": Operator(
        lambda g, v, s: (atrous_step(v, 2, alike, [g], s).values,), (1, 3, 1), (3,), traced=False
    ),
    "joint_bilateral": Operator(bilateral, (3, 3, 1, 1), (3,), traced=False),
}
every = pytest.mark.parametrize("name", OPERATORS)


def images(name: str, dtype: torch.dtype = torch.float32) -> list[Tensor]:
    """Random arguments, (N, C, H, W); none is a whole number, where motion may fetch either of two pixels."""
    operator, generator = OPERATORS[name], torch.Generator().manual_seed(3)
    made = []
    for number, channels in enumerate(operator.channels):
        size = (H // 2, W // 2) if number in operator.coarse else (H, W)
        made.append((torch.rand(N, channels, *size, generator=generator) * 3 - 0.7).to(dtype))
    return made


def close(found: Outputs, expected: Outputs) -> None:
    assert len(found) == len(expected)
    for ours, theirs in zip(found, expected, strict=True):
        torch.testing.assert_close(ours, theirs, equal_nan=True, check_dtype=False, rtol=1e-4, atol=1e-5)


@every
def test_the_results_have_the_size_of_the_image_and_their_channels(name: str) -> None:
    found = OPERATORS[name].call(*images(name))
    assert [tuple(image.shape) for image in found] == [(N, channels, H, W) for channels in OPERATORS[name].returns]


@every
def test_sequences_of_a_batch_know_nothing_of_each_other(name: str) -> None:
    given = images(name)
    alone = [OPERATORS[name].call(*(image[n : n + 1] for image in given)) for n in range(N)]
    close(OPERATORS[name].call(*given), tuple(map(torch.cat, zip(*alone, strict=True))))


@every
def test_what_is_given_is_left_as_it_is_and_may_lie_in_memory_in_any_order(name: str) -> None:
    given = images(name)
    expected = OPERATORS[name].call(*given)
    turned = [image.mT.contiguous().mT for image in given]  # column by column
    last = [image.to(memory_format=torch.channels_last) for image in given]
    close(OPERATORS[name].call(*turned), expected)
    close(OPERATORS[name].call(*last), expected)
    for kept in (given, turned, last):
        assert all(map(torch.equal, kept, images(name)))


@every
def test_doubles_stay_doubles(name: str) -> None:
    found = OPERATORS[name].call(*images(name, torch.float64))
    assert all(image.dtype in (torch.float64, torch.bool) for image in found)
    close(found, OPERATORS[name].call(*images(name)))


@every
def test_it_stays_on_its_device(name: str) -> None:
    """PyTorch's `meta` device computes nothing, and refuses to meet a tensor of another device."""
    found = OPERATORS[name].call(*(image.to("meta") for image in images(name)))
    assert {image.device.type for image in found} == {"meta"}


@pytest.mark.parametrize(
    ("name", "number"),
    [(name, number) for name, operator in OPERATORS.items() for number in range(1, len(operator.channels))],
)
def test_images_of_two_sizes_are_refused(name: str, number: int) -> None:
    given = images(name)
    given[number] = torch.cat([given[number], given[number][..., :2]], 3)
    with pytest.raises((RuntimeError, ValueError, IndexError, NteError)):
        OPERATORS[name].call(*given)


@pytest.mark.parametrize("name", [name for name, operator in OPERATORS.items() if operator.trained])
def test_gradients(name: str) -> None:
    operator, given = OPERATORS[name], [image[:1] for image in images(name, torch.float64)]
    for number in operator.trained:
        given[number].requires_grad_()
    assert torch.autograd.gradcheck(lambda *x: operator.call(*x)[0], given)


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name, operator in OPERATORS.items() if operator.traced])
def test_it_compiles_to_one_graph(name: str) -> None:
    """Without code generation, which is PyTorch's own: a break in the graph is what would be ours."""
    compiled = torch.compile(OPERATORS[name].call, backend="eager", fullgraph=True)
    with torch.no_grad():
        close(compiled(*images(name)), OPERATORS[name].call(*images(name)))
