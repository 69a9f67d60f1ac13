"""By how much a whole image has moved: shifts that are known, and images that say nothing."""

import pytest
import torch

from nte.motion.whole_shift import nearest_shift, whole_shift
from tests.motion.test_correspondence import hills, noisy, stars, texture


@pytest.mark.parametrize(("x", "y"), [(0, 0), (7, 0), (-31, 12), (40, -25), (-3, -44)])
@pytest.mark.parametrize("size", [(181, 240), (200, 173)])
def test_a_shift_is_found_whatever_its_sign_and_the_size_of_the_image(x: int, y: int, size: tuple[int, int]) -> None:
    large = texture((size[0] + 100, size[1] + 100))[None, None]
    noise = [0.05 * torch.randn(1, 1, *size, generator=torch.Generator().manual_seed(seed)) for seed in (1, 2)]
    previous = large[..., 50 : 50 + size[0], 50 : 50 + size[1]] + noise[0]
    current = large[..., 50 + y : 50 + y + size[0], 50 + x : 50 + x + size[1]] + noise[1]
    found = whole_shift(current, previous)
    assert max(abs(found[0] - x), abs(found[1] - y)) <= 1  # to a pixel under noise


@pytest.mark.parametrize("shift", [(24, 9), (-31, 18), (5, -22), (-17, -3)])
@pytest.mark.parametrize("step", [1, 4, 8])
def test_a_shift_known_roughly_is_found_to_the_pixel(shift: tuple[int, int], step: int) -> None:
    """Of an image that is all but flat, whose details are single pixels."""
    (x, y), size = shift, (101, 133)
    large = stars((size[0] + 100, size[1] + 100)).repeat(1, 2, 1, 1)
    previous = large[..., 50 : 50 + size[0], 50 : 50 + size[1]]
    current = large[..., 50 + y : 50 + y + size[0], 50 + x : 50 + x + size[1]]
    roughly = (step * round(x / step), step * round(y / step))
    assert nearest_shift(current, previous, *roughly, step) == shift
    assert nearest_shift(current * 0, previous * 0, *roughly, step) == roughly


def test_what_moves_by_itself_does_not_count_as_the_whole() -> None:
    previous = 0.2 * texture((160, 200))[None, None].repeat(1, 3, 1, 1)
    current = previous.clone()
    previous[..., 40:60, 40:60] = 5.0  # by far the brightest thing
    current[..., 40:60, 65:85] = 5.0
    assert whole_shift(current, previous) == (0, 0)


def test_shifts_are_limited_to_a_share_of_the_image() -> None:
    large = texture((128, 320))[None, None]
    current, previous = large[..., 70:270], large[..., :200]
    assert whole_shift(current, previous, farthest=0.5) == (70, 0)
    assert whole_shift(current, previous, farthest=0.25) != (70, 0)


@pytest.mark.parametrize("size", [(1, 1), (1, 9), (3, 200), (2, 2), (64, 48)])
def test_images_that_say_nothing_stand_still(size: tuple[int, int]) -> None:
    flat = torch.full((1, 1, *size), 0.4)
    assert whole_shift(flat, flat) == (0, 0)
    assert whole_shift(flat + 1, flat) == (0, 0)
    noise = torch.rand(1, 1, *size, generator=torch.Generator().manual_seed(0))
    assert whole_shift(noise, noise) == (0, 0)


@pytest.mark.parametrize("size", [(12, 18), (16, 16), (24, 36), (48, 64), (70, 64)])
def test_the_noise_of_a_small_image_is_no_shift(size: tuple[int, int]) -> None:
    """Few means agree by chance: of 16 shifts some do, and of an overlap of 9 px every one does."""
    shifted = 0
    for seed in range(8):
        image = 0.5 + 0.4 * texture(size, seed)
        noise = torch.empty(2, *size).exponential_(generator=torch.Generator().manual_seed(seed))
        light = image * noise
        now, before = (light / (1 + light))[:, None, None]
        shifted += whole_shift(now, before, farthest=0.5) != (0, 0)
    assert shifted <= 1


@pytest.mark.parametrize("size", [(60, 80), (65, 64)])
def test_the_pan_of_a_small_image_is_a_shift(size: tuple[int, int]) -> None:
    large = texture((size[0] + 10, size[1] + 12))[None, None]
    current, previous = large[..., : size[0], 12:], large[..., 10:, : size[1]]
    assert whole_shift(current, previous, farthest=0.5) == (12, -10)


@pytest.mark.parametrize("sky", [0.0, 0.37])
@pytest.mark.parametrize("noise", [0.0, 0.05])
def test_a_background_without_noise_hides_no_shift_of_what_stands_before_it(sky: float, noise: float) -> None:
    large = hills((208, 260), 0.35, sky)
    views = large[..., 8:, 20:], large[..., :-8, :-20]
    current, previous = (torch.where(view == sky, view, noisy(view, noise, seed)) for seed, view in enumerate(views))
    found = whole_shift(current, previous, farthest=0.5)
    assert max(abs(found[0] - 20), abs(found[1] - 8)) <= 1
    assert whole_shift(previous, previous, farthest=0.5) == (0, 0)


@pytest.mark.parametrize("share", [0.05, 0.1, 0.3])
def test_noise_before_a_background_without_noise_is_no_shift(share: float) -> None:
    """What is compared with a background differs by its own noise alone, and little noise agrees by chance."""
    shifted = 0
    for seed in range(12):
        image = hills((75, 100), share, 0.37)
        noise = torch.empty(2, *image.shape[2:]).exponential_(generator=torch.Generator().manual_seed(seed))
        light = image / (1 - image) * noise
        now, before = torch.where(image == 0.37, image, light / (1 + light))[0][:, None, None]
        shifted += whole_shift(now, before, farthest=0.5) != (0, 0)
    assert shifted <= 1


@pytest.mark.parametrize("share", [0.35, 0.5])
def test_noise_before_a_gradient_without_noise_is_no_shift(share: float) -> None:
    """A sky that brightens downwards fits every shift along x, and fills about half of the image."""
    shifted = 0
    for seed in range(8):
        ground = hills((75, 100), share, -1.0)
        rows = torch.arange(75.0).view(-1, 1).expand(75, 100)
        noise = torch.empty(2, 75, 100).exponential_(generator=torch.Generator().manual_seed(seed))
        now, before = (torch.where(ground < 0, 0.3 + 0.5 * (rows / 75) ** 2, ground * one) for one in noise)
        shifted += whole_shift(now / (1 + now), before / (1 + before), farthest=0.5) != (0, 0)
    assert shifted == 0
