import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from nte.motion.warp import fetch_nearest, pixel_centres, warp


def test_shape_and_batch() -> None:
    image, motion = torch.rand(2, 5, 7, 9), torch.zeros(2, 2, 7, 9)
    warped = warp(image, motion)
    assert warped.image.shape == image.shape
    assert warped.valid.shape == (2, 1, 7, 9)
    assert warped.valid.dtype == torch.bool


def test_zero_motion_is_identity() -> None:
    image = torch.rand(1, 3, 33, 47)
    warped = warp(image, torch.zeros(1, 2, 33, 47))
    torch.testing.assert_close(warped.image, image, atol=2e-5, rtol=0)
    assert warped.valid.all()


def test_whole_pixels_are_fetched_from_current_plus_motion() -> None:
    image = torch.arange(30.0).view(1, 1, 5, 6)
    motion = torch.tensor([2.0, -1.0]).view(1, 2, 1, 1).expand(1, 2, 5, 6)
    warped = warp(image, motion)
    torch.testing.assert_close(warped.image[..., 1:, :4], image[..., :-1, 2:], atol=1e-4, rtol=0)
    expected = torch.zeros(5, 6, dtype=torch.bool)
    expected[1:, :4] = True
    assert torch.equal(warped.valid[0, 0], expected)


def test_a_fraction_interpolates_between_neighbours() -> None:
    ramp = torch.arange(8.0).expand(1, 1, 4, 8)
    motion = torch.zeros(1, 2, 4, 8)
    motion[:, 0] = 0.25
    torch.testing.assert_close(warp(ramp, motion).image[..., :-1], ramp[..., :-1] + 0.25)


@given(st.floats(-1e38, 1e38), st.floats(-60, 60))
def test_a_constant_stays_constant(x: float, y: float) -> None:
    motion = torch.tensor([x, y]).view(1, 2, 1, 1).expand(1, 2, 6, 5)
    torch.testing.assert_close(warp(torch.full((1, 3, 6, 5), 7.0), motion).image, torch.full((1, 3, 6, 5), 7.0))


@pytest.mark.parametrize("bad", [float("nan"), float("inf"), -float("inf"), 1e30])
def test_bad_motion_is_invalid_and_harmless(bad: float) -> None:
    motion = torch.zeros(1, 2, 4, 4)
    motion[0, 0, 1, 2] = bad
    warped = warp(torch.rand(1, 3, 4, 4), motion)
    assert warped.image.isfinite().all()
    assert (~warped.valid).sum() == 1
    assert not warped.valid[0, 0, 1, 2]


def test_gradients_flow_into_the_image() -> None:
    image = torch.rand(1, 2, 4, 5, dtype=torch.float64, requires_grad=True)
    motion = torch.rand(1, 2, 4, 5, dtype=torch.float64)
    assert torch.autograd.gradcheck(lambda i: warp(i, motion).image, (image,))


def test_nearest_takes_the_pixel_that_holds_the_position() -> None:
    image = torch.arange(12.0).view(1, 1, 3, 4)
    position = pixel_centres(image) + torch.tensor([0.49, -0.51]).view(1, 2, 1, 1)
    fetched = fetch_nearest(image, position)
    assert torch.equal(fetched[0, 0, 1:], image[0, 0, :-1])
    assert torch.equal(fetched[0, 0, 0], image[0, 0, 0])  # above the image: its border
