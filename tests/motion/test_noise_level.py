"""The noise of an image: what was added is what is measured, whatever the image shows."""

import pytest
import torch

from nte.color import display
from nte.motion.noise_level import noise_level
from nte.motion.search import SEARCHES, noise_of
from nte.motion.warp import pixel_centres
from tests.motion.test_correspondence import disc, noisy


@pytest.mark.parametrize("sigma", [0.005, 0.03, 0.2])
@pytest.mark.parametrize("size", [(90, 131), (240, 61)])
def test_the_noise_of_a_slanted_plane_is_what_was_added(sigma: float, size: tuple[int, int]) -> None:
    rows, columns = torch.meshgrid(torch.arange(float(size[0])), torch.arange(float(size[1])), indexing="ij")
    plane = (0.01 * rows - 0.03 * columns)[None, None]
    assert noise_level(plane).item() < 1e-4
    assert noise_level(noisy(plane, sigma, 1)).item() == pytest.approx(sigma, rel=0.15)


def test_edges_and_texture_are_no_noise_and_each_image_of_a_batch_has_its_own() -> None:
    clean, coarse = disc(100, 120), noisy(disc(100, 120), 0.1, 3)
    level = noise_level(torch.cat([clean, coarse]))
    assert level[0] < 0.01
    assert level[1] == pytest.approx(0.1, rel=0.15)
    assert torch.equal(level[1:], noise_level(coarse))


def test_a_background_without_noise_does_not_count_and_constant_areas_with_edges_have_none() -> None:
    """A thing of a fifth of the image at 1 sample per pixel, before black, before a sky, and as flat as a cartoon."""
    here = pixel_centres(torch.zeros(1, 1, 200, 240))
    thing = (here - torch.tensor([130.0, 90.0]).view(1, 2, 1, 1)).square().sum(1, keepdim=True) < 55**2
    light = 0.6 * torch.empty(1, 1, 200, 240).exponential_(generator=torch.Generator().manual_seed(1))
    image = light / (1 + light)
    expected = noise_level(image)
    for sky in (0.0, 0.37):
        found = image.where(thing, sky)
        assert noise_level(found).item() == pytest.approx(expected.item(), rel=0.25)
        assert noise_of(found) == noise_of(image) == "noisy"
        assert noise_level(torch.full_like(image, 0.8).where(thing, sky)) == 0


def test_the_noisiest_channel_counts_and_tiny_images_have_none() -> None:
    colour = torch.cat([torch.zeros(1, 1, 60, 60), noisy(torch.zeros(1, 1, 60, 60), 0.1, 2)], 1)
    assert noise_level(colour).item() == pytest.approx(0.1, rel=0.2)
    assert noise_level(torch.rand(2, 1, 2, 50)).tolist() == [0, 0]


@pytest.mark.parametrize("share", [0.3, 0.45])
def test_a_sky_whose_gradient_is_rounded_to_half_floats_does_not_count_either(share: float) -> None:
    here = pixel_centres(torch.zeros(1, 1, 200, 240))
    rows, columns = here[:, 1:], here[:, :1]
    sky = 0.3 + 0.5 * (rows / 200).square() + 0.2 * torch.sin(columns / 120)
    light = 0.6 * torch.empty(1, 1, 200, 240).exponential_(generator=torch.Generator().manual_seed(1))
    light = torch.where(rows + 0.1 * columns > 200 * (1 - share) + 12, light, sky)
    image = display(light.half().float(), torch.ones(1))
    assert noise_of(image) == "noisy"
    assert noise_of(display(sky.half().float(), torch.ones(1))) == "clean"


@pytest.mark.parametrize(("sigma", "name"), [(0, "clean"), (0.03, "moderate"), (0.1, "noisy"), (0.5, "strong")])
def test_more_noise_chooses_a_search_for_more_noise(sigma: float, name: str) -> None:
    assert name in SEARCHES
    assert noise_of(noisy(disc(100, 120), sigma, 1)) == name
    spoilt = noisy(disc(100, 120), sigma, 1)
    spoilt[..., :3, :5] = float("nan")
    assert noise_of(spoilt) == name
    assert noise_of(torch.full((1, 1, 8, 8), float("nan"))) == "clean"
