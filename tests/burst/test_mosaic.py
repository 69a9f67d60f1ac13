"""Colour filter arrays: blocks that compare, and pixels of the same colour."""

import itertools

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from nte.burst.mosaic import Mosaic, pattern_of
from nte.errors import NteError
from tests.burst.dng import BAYER, XTRANS
from tests.burst.scenes import PATTERNS, mosaic_of

STARTS = [("bayer", y, x) for y in range(2) for x in range(2)] + [("xtrans", y, x) for y in range(6) for x in range(6)]


def rolled(name: str, y: int, x: int) -> Mosaic:
    """The array of an image that starts at another pixel of the sensor."""
    return Mosaic(tuple(map(tuple, np.roll(PATTERNS[name], (-y, -x), (0, 1)).tolist())))


@pytest.mark.parametrize(("name", "y", "x"), STARTS)
def test_blocks_of_a_coloured_ground_are_of_one_grey(name: str, y: int, x: int) -> None:
    mosaic = rolled(name, y, x)
    image = torch.tensor([0.1, 0.5, 0.9])[mosaic.colours(26, 29)][None, None]
    grey = mosaic.bin(image)
    assert grey.numel() >= 64
    torch.testing.assert_close(grey, torch.full_like(grey, float(grey[0, 0, 0, 0])))


@pytest.mark.parametrize("name", PATTERNS)
def test_a_motion_by_whole_periods_copies(name: str) -> None:
    mosaic, generator = mosaic_of(name), torch.Generator().manual_seed(0)
    image = torch.rand(1, 1, 30, 36, generator=generator)
    x, y = 2 * mosaic.period, -mosaic.period
    motion = torch.tensor([x, y], dtype=torch.float32).view(1, 2, 1, 1).expand(1, 2, 30, 36)
    fetched, valid = mosaic.fetch(image, motion)
    moved = image.roll((-y, -x), (2, 3))
    assert valid[..., -y:, : 36 - x].all()
    assert not valid[..., :-y, :].any()
    assert not valid[..., 36 - x :].any()
    torch.testing.assert_close(fetched[valid], moved[valid], rtol=0, atol=0)


@pytest.mark.parametrize("name", PATTERNS)
def test_any_motion_fetches_the_nearest_pixel_of_the_same_colour(name: str) -> None:
    """Against the slow search through all pixels; equally near to a sixteenth of a pixel counts as nearest."""
    mosaic, generator = mosaic_of(name), torch.Generator().manual_seed(1)
    height, width = 12, 18
    index = torch.arange(height * width, dtype=torch.float32).view(1, 1, height, width)
    motion = (torch.rand(1, 2, height, width, generator=generator) - 0.5) * 7
    fetched, valid = mosaic.fetch(index, motion)
    colours = mosaic.colours(height, width)
    places = torch.stack(torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij"), -1) + 0.5
    farthest = 0.0
    for y, x in itertools.product(range(height), range(width)):
        if not valid[0, 0, y, x]:
            continue
        target = places[y, x] + motion[0, :, y, x].flip(0)
        distance = (places - target).norm(dim=-1)
        found = divmod(int(fetched[0, 0, y, x]), width)
        assert colours[found] == colours[y, x]
        inner = 3 <= target[0] <= height - 3 and 3 <= target[1] <= width - 3  # where all candidates are inside
        assert not inner or distance[found] <= distance[colours == colours[y, x]].min() + 0.18
        farthest = max(farthest, float(distance[found]))
    assert valid.float().mean() > 0.5
    assert farthest < 2.5


def test_the_array_is_read_from_the_sensors_colours() -> None:
    four = np.tile([[0, 1], [3, 2]], (5, 7))  # LibRaw counts the two greens of a Bayer array apart
    assert pattern_of(four, "RGBG") == Mosaic(((0, 1), (1, 2)))
    assert pattern_of(np.tile(BAYER, (3, 4))[:5, :7], "RGBG").block == 2
    assert pattern_of(np.tile(XTRANS, (3, 4))[:13, :20], "RGBG").block == 3


@pytest.mark.parametrize(
    "colours",
    [np.zeros((8, 8), int), np.random.default_rng(0).integers(0, 3, (12, 12)), np.tile([[0, 1], [1, 0]], (4, 4))],
    ids=["one colour", "no period", "no blue"],
)
def test_other_sensors_are_refused(colours: np.ndarray) -> None:
    with pytest.raises(NteError, match="expected a"):
        pattern_of(colours, "RGBG")


def test_motion_of_blocks_becomes_motion_of_pixels() -> None:
    mosaic = rolled("xtrans", 2, 1)
    motion = torch.tensor([0.5, -2.0]).view(1, 2, 1, 1).expand(1, 2, 9, 7)
    spread = mosaic.spread(motion, 30, 24)
    assert spread.shape == (1, 2, 30, 24)
    torch.testing.assert_close(spread, torch.tensor([1.5, -6.0]).view(1, 2, 1, 1).expand(1, 2, 30, 24))


@given(st.sampled_from(STARTS), st.tuples(st.integers(-3, 3), st.integers(-2, 2)), st.integers(0, 10_000))
def test_whole_periods_there_and_back_are_the_same_pixels(
    start: tuple[str, int, int], periods: tuple[int, int], seed: int
) -> None:
    mosaic = rolled(*start)
    image = torch.rand(1, 1, 17, 22, generator=torch.Generator().manual_seed(seed))
    motion = torch.tensor(periods).mul(mosaic.period).float().view(1, 2, 1, 1).expand(1, 2, 17, 22)
    there, valid = mosaic.fetch(image, motion)
    back, inside = mosaic.fetch(there, -motion)
    inside &= mosaic.fetch(valid.float(), -motion)[0] > 0
    x, y = (mosaic.period * abs(count) for count in periods)
    assert inside.sum() == max(0, 17 - y) * max(0, 22 - x)
    assert torch.equal(back[inside], image[inside])


@given(st.sampled_from(STARTS), st.integers(0, 10_000))
def test_a_coloured_ground_stays_what_it_is_whatever_the_motion(start: tuple[str, int, int], seed: int) -> None:
    mosaic, generator = rolled(*start), torch.Generator().manual_seed(seed)
    image = torch.tensor([0.1, 0.5, 0.9])[mosaic.colours(13, 16)][None, None]
    fetched, valid = mosaic.fetch(image, 12 * torch.randn(1, 2, 13, 16, generator=generator))
    assert valid.any()
    assert torch.equal(fetched[valid], image[valid])
