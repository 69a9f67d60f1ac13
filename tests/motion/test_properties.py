"""What holds for every image and every motion: fetching and scattering as each other's inverse, and their linearity."""

import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor

from nte.motion.geometric import dual_motion, scatter_forward_motion
from nte.motion.warp import fetch_nearest, pixel_centres, warp
from nte.training.augment import Augmentation

SIZES = st.tuples(st.integers(1, 9), st.integers(1, 9))
SHIFTS = st.tuples(st.integers(-10, 10), st.integers(-10, 10))
SEEDS = st.integers(0, 10_000)


def randn(*shape: int, seed: int) -> Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed))


def uniform(shift: tuple[int, int], size: tuple[int, int]) -> Tensor:
    """The same motion (x, y) in every pixel."""
    return torch.tensor(shift, dtype=torch.float32).view(1, 2, 1, 1).expand(1, 2, *size)


def whole_motion(size: tuple[int, int], seed: int) -> Tensor:
    """Whole pixels, each pixel its own, all to places inside the image."""
    height, width = size
    generator = torch.Generator().manual_seed(seed)
    x = torch.randint(width, (1, 1, height, width), generator=generator)
    y = torch.randint(height, (1, 1, height, width), generator=generator)
    return torch.cat([x, y], 1) + 0.5 - pixel_centres(x)


@given(SIZES, SHIFTS, SEEDS)
def test_a_whole_shift_is_a_roll_without_what_comes_round(size: tuple[int, int], shift: tuple[int, int], seed: int):
    image, (x, y) = randn(2, 3, *size, seed=seed), shift
    found = warp(image, uniform(shift, size).expand(2, -1, -1, -1))
    rolled = image.roll((-y, -x), (2, 3))
    here = pixel_centres(image) + torch.tensor([x, y]).view(1, 2, 1, 1)
    held = (here > 0).all(1) & (here[:, 0] < size[1]) & (here[:, 1] < size[0])
    assert torch.equal(found.valid, held[:, None].expand(2, -1, -1, -1))
    torch.testing.assert_close(found.image.where(found.valid, 0), rolled.where(found.valid, 0), atol=1e-5, rtol=1e-5)


@given(SIZES, SHIFTS, SEEDS)
def test_there_and_back_is_the_image_where_both_were_inside(size: tuple[int, int], shift: tuple[int, int], seed: int):
    image, motion = randn(1, 2, *size, seed=seed), uniform(shift, size)
    there = warp(image, motion)
    back = warp(there.image, -motion)
    inside = back.valid & (warp(there.valid.float(), -motion).image > 0.5)
    assert inside.sum() == max(0, size[0] - abs(shift[1])) * max(0, size[1] - abs(shift[0]))
    torch.testing.assert_close(back.image.where(inside, 0), image.where(inside, 0), atol=1e-5, rtol=1e-5)


@given(SIZES, SEEDS, st.floats(-3, 3, width=32))
def test_fetching_is_linear_in_the_image(size: tuple[int, int], seed: int, factor: float):
    first, second, motion = randn(3, 2, *size, seed=seed).mul(4).split(1)
    together = warp(factor * first + second, motion).image
    apart = factor * warp(first, motion).image + warp(second, motion).image
    torch.testing.assert_close(together, apart, atol=1e-4, rtol=1e-4)


@given(SIZES, SEEDS)
def test_what_is_scattered_leads_back_to_where_it_came_from(size: tuple[int, int], seed: int):
    motion, depth = whole_motion(size, seed), randn(1, 1, *size, seed=seed).abs()
    forward = scatter_forward_motion(motion, depth)
    known = forward.isfinite()
    came_from = pixel_centres(motion) + forward.nan_to_num()
    torch.testing.assert_close(fetch_nearest(motion, came_from)[known], -forward[known])
    # Every pixel leads to one that is known, and none but these are.
    reached = torch.zeros(size, dtype=torch.bool)
    target = (pixel_centres(motion) + motion)[0].long()
    reached[target[1], target[0]] = True
    assert torch.equal(known, reached.expand(1, 2, *size))


@given(SIZES, SEEDS)
def test_a_permutation_scattered_and_scattered_again_is_itself(size: tuple[int, int], seed: int):
    height, width = size
    order = torch.randperm(height * width, generator=torch.Generator().manual_seed(seed)).view(1, 1, height, width)
    motion = torch.cat([order % width, order.div(width, rounding_mode="floor")], 1) + 0.5 - pixel_centres(order)
    depth = torch.ones(1, 1, *size)
    torch.testing.assert_close(scatter_forward_motion(scatter_forward_motion(motion, depth), depth), motion)


@given(SIZES, SEEDS, st.tuples(st.booleans(), st.booleans(), st.booleans()))
def test_mirrored_and_transposed_vectors_have_mirrored_and_transposed_duals(
    size: tuple[int, int], seed: int, symmetry: tuple[bool, bool, bool]
):
    """The surfaces have different depths: of equally near ones the last wins, which a mirror turns into the first."""
    motion, forward = 2 * randn(1, 2, *size, seed=seed), 2 * randn(1, 2, *size, seed=seed + 1)
    forward[randn(1, 1, *size, seed=seed + 2).expand_as(forward) > 1] = torch.nan
    depth, before = (randn(1, 1, *size, seed=seed + k).abs() + 0.01 for k in (3, 4))
    change = Augmentation(*symmetry)

    def turned(vectors: Tensor, scalar: Tensor) -> tuple[Tensor, Tensor]:
        found = change({"motion": vectors, "depth": scalar.float()})
        return found["motion"], found["depth"]

    (other, other_depth), (other_forward, other_before) = turned(motion, depth), turned(forward, before)
    expected = dual_motion(motion, forward, depth, before)
    found = dual_motion(other, other_forward, other_depth, other_before)
    vectors, disoccluded = turned(expected.motion, expected.disoccluded)
    torch.testing.assert_close(found.motion, vectors, atol=1e-5, rtol=0)
    assert torch.equal(found.disoccluded, disoccluded > 0)
    scattered, _ = turned(scatter_forward_motion(motion, depth), depth)
    torch.testing.assert_close(scatter_forward_motion(other, other_depth), scattered, atol=1e-5, rtol=0, equal_nan=True)
