import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor

from nte.models.kernels import apply_kernels, average, combine_scales
from nte.models.prediction import weights


def apply_slowly(image: Tensor, kernels: Tensor) -> Tensor:
    """The same sum written pixel by pixel, fetching clamped positions."""
    count, _, height, width = image.shape
    size = int(kernels.shape[1] ** 0.5)
    result = torch.zeros_like(image)
    for n in range(count):
        for y in range(height):
            for x in range(width):
                for tap in range(size * size):
                    fetch_y = min(max(y + tap // size - size // 2, 0), height - 1)
                    fetch_x = min(max(x + tap % size - size // 2, 0), width - 1)
                    result[n, :, y, x] += kernels[n, tap, y, x] * image[n, :, fetch_y, fetch_x]
    return result


SHAPES = [(1, (1, 2, 3, 4)), (3, (2, 3, 5, 4)), (5, (2, 1, 3, 7)), (5, (1, 3, 1, 1))]


@pytest.mark.parametrize(("size", "shape"), SHAPES)
def test_equals_a_loop_over_pixels(size: int, shape: tuple[int, int, int, int]) -> None:
    image, kernels = torch.rand(shape), torch.randn(shape[0], size**2, *shape[2:])
    torch.testing.assert_close(apply_kernels(image, kernels), apply_slowly(image, kernels))


@given(st.integers(0, 10_000), st.floats(-1e3, 1e3, width=32))
def test_kernels_that_sum_to_one_keep_a_constant(seed: int, value: float) -> None:
    generator = torch.Generator().manual_seed(seed)
    kernels = torch.randn(2, 25, 6, 7, generator=generator).softmax(1)
    constant = torch.full((2, 3, 6, 7), value)
    torch.testing.assert_close(apply_kernels(constant, kernels), constant, rtol=1e-5, atol=1e-6)


@given(st.integers(0, 10_000), st.floats(0, 1e3), st.floats(1e-3, 1e4))
def test_an_average_is_a_softmax_in_effect(seed: int, spread: float, value: float) -> None:
    """Of any numbers, also far beyond those that the exponential holds; a constant stays constant."""
    generator = torch.Generator().manual_seed(seed)
    values = spread * torch.randn(2, 25, 6, 7, generator=generator)
    image, constant = torch.rand(2, 3, 6, 7, generator=generator), torch.full((2, 3, 6, 7), value)
    torch.testing.assert_close(average(constant, weights(values)), constant, rtol=1e-5, atol=0)
    limited = values.clamp(-15, 15)
    torch.testing.assert_close(average(image, weights(values)), apply_kernels(image, limited.softmax(1)))


def test_the_middle_tap_alone_is_the_identity_and_its_neighbour_shifts() -> None:
    image = torch.rand(1, 3, 5, 8)
    kernels = torch.zeros(1, 9, 5, 8)
    kernels[:, 4] = 1
    assert torch.equal(apply_kernels(image, kernels), image)
    # Tap 5 lies to the right of the middle: it fetches x + 1.
    assert torch.equal(apply_kernels(image, kernels.roll(1, 1))[..., :-1], image[..., 1:])
    # Tap 7 lies below: it fetches y + 1.
    assert torch.equal(apply_kernels(image, kernels.roll(3, 1))[..., :-1, :], image[..., 1:, :])


def test_gradients_of_kernels() -> None:
    image = torch.rand(1, 2, 4, 3, dtype=torch.double, requires_grad=True)
    kernels = torch.rand(1, 9, 4, 3, dtype=torch.double, requires_grad=True)
    assert torch.autograd.gradcheck(apply_kernels, (image, kernels))


@pytest.mark.parametrize("downsample", ["mean", "max"])
def test_gradients_of_the_combination(downsample: str) -> None:
    # Distinct values: the maximum has no derivative where two are equal.
    fine = torch.randperm(32, dtype=torch.double).view(1, 2, 4, 4).div(10).requires_grad_()
    coarse = torch.rand(1, 2, 2, 2, dtype=torch.double, requires_grad=True)
    alpha = torch.rand(1, 1, 2, 2, dtype=torch.double, requires_grad=True)
    assert torch.autograd.gradcheck(lambda *x: combine_scales(*x, downsample), (fine, coarse, alpha))


def test_equation_4_by_hand() -> None:
    # A single coarse pixel: upsampling is a constant. D(f) = 4 (mean 2.5), c = 10, α = ½.
    fine = torch.tensor([[1.0, 2.0], [3.0, 4.0]]).view(1, 1, 2, 2)
    coarse, alpha = torch.full((1, 1, 1, 1), 10.0), torch.full((1, 1, 1, 1), 0.5)
    assert torch.equal(combine_scales(fine, coarse, alpha, "max"), fine + 0.5 * (10 - 4))
    assert torch.equal(combine_scales(fine, coarse, alpha, "mean"), fine + 0.5 * (10 - 2.5))


def test_equation_4_upsamples_bilinearly() -> None:
    # Two coarse pixels that change by 0 and 4: bilinear halves in between, with pixel centres aligned.
    fine = torch.zeros(1, 1, 2, 4)
    coarse = torch.tensor([0.0, 4.0]).view(1, 1, 1, 2)
    combined = combine_scales(fine, coarse, torch.ones(1, 1, 1, 2), "mean")
    assert combined[0, 0, 0].tolist() == [0, 1, 3, 4]


def test_alpha_zero_keeps_the_fine_image() -> None:
    fine, coarse = torch.rand(2, 3, 8, 6), torch.rand(2, 3, 4, 3)
    assert torch.equal(combine_scales(fine, coarse, torch.zeros(2, 1, 4, 3), "mean"), fine)


def test_the_mean_keeps_constants_and_energy_and_the_maximum_darkens() -> None:
    constant = torch.full((1, 3, 8, 8), 2.0)
    alpha = torch.rand(1, 1, 4, 4)
    for downsample in ("mean", "max"):
        combined = combine_scales(constant, constant[..., :4, :4], alpha, downsample)
        torch.testing.assert_close(combined, constant)
    # The low frequencies are replaced by themselves: nothing changes for the mean. α alike everywhere.
    fine = torch.rand(1, 3, 8, 8)
    coarse, alike = torch.nn.functional.avg_pool2d(fine, 2), torch.full((1, 1, 4, 4), 0.7)
    torch.testing.assert_close(combine_scales(fine, coarse, alike, "mean"), fine)
    assert combine_scales(fine, coarse, alike, "max").mean() < fine.mean()


@pytest.mark.parametrize("wanted", [(True, True), (True, False), (False, True)])
def test_the_backward_pass_is_that_of_the_slices(wanted: tuple[bool, bool]) -> None:
    generator = torch.Generator().manual_seed(3)
    upstream = torch.randn(2, 3, 5, 8, generator=generator)
    found: list[list[Tensor | None]] = []
    for apply in (apply_kernels, apply_slowly):
        image = torch.randn(2, 3, 5, 8, generator=generator.manual_seed(4), requires_grad=wanted[0])
        kernels = torch.randn(2, 25, 5, 8, generator=generator, requires_grad=wanted[1])
        apply(image, kernels).backward(upstream)
        found.append([image.grad, kernels.grad])
    for ours, theirs in zip(*found, strict=True):
        torch.testing.assert_close(ours, theirs)


def test_autograd_records_one_operation_for_all_taps() -> None:
    image, kernels = torch.rand(1, 3, 6, 7, requires_grad=True), torch.rand(1, 25, 6, 7, requires_grad=True)
    saved: list[Tensor] = []
    with torch.autograd.graph.saved_tensors_hooks(lambda tensor: saved.append(tensor) or tensor, lambda kept: kept):
        apply_kernels(image, kernels)
    assert len(saved) <= 3  # the image, padded, and the kernels: for each tap by itself it would be over 50


@pytest.mark.filterwarnings("ignore:.*torch.jit.trace:DeprecationWarning", "ignore::torch.jit.TracerWarning")
def test_a_trace_consists_of_plain_operators() -> None:
    image, kernels = torch.rand(1, 3, 6, 7), torch.rand(1, 9, 6, 7)
    with torch.no_grad():
        traced = torch.jit.trace(apply_kernels, (image, kernels))
    kinds = {node.kind() for node in traced.graph.nodes()}
    assert kinds
    assert not any(kind.startswith("prim::Python") for kind in kinds)
    other = torch.rand(2, 3, 9, 5), torch.rand(2, 9, 9, 5)
    torch.testing.assert_close(traced(*other), apply_kernels(*other))
