"""Pixels that tell nothing, in SVGF and A-SVGF: what is around them speaks for them."""

import numpy as np
import pytest

from nte.filters.asvgf import Asvgf
from nte.filters.svgf import Svgf, SvgfOptions
from nte.frames.frame import Frame
from nte.session import Session
from tests.filters.sequences import noisy_frames, still_channels

pytestmark = pytest.mark.filterwarnings("ignore::nte.frames.bad.BadPixelWarning")


def holed(frame: Frame, share: float) -> Frame:
    """The frame with this share of its pixels NaN."""
    holes = np.random.default_rng(frame.index).random(frame.size) < share
    return frame.with_channels(color=np.where(holes, np.float32(np.nan), frame["color"]))


@pytest.mark.parametrize("make", [Svgf, Asvgf])
def test_a_tenth_of_all_pixels_that_are_nan_do_not_darken_the_image(make: type[Svgf]) -> None:
    channels = still_channels((31, 44))
    channels["gradient"] = np.full((1, 2, 31, 44), np.nan, np.float32)
    frames = noisy_frames(8, channels)
    whole, broken = Session(make()), Session(make())
    for frame in frames:
        expected, image = whole.denoise(frame), broken.denoise(holed(frame, 0.1))
        assert image.mean() == pytest.approx(expected.mean(), rel=0.02)
    assert image.mean() == pytest.approx(expected.mean(), rel=0.005)


def test_where_nothing_around_is_known_nothing_is_invented() -> None:
    """Filling reaches 3, 12 and 48 pixels in turn."""
    frame = noisy_frames(1, still_channels((20, 140)))[0]
    color = frame["color"].copy()
    color[..., :100] = np.nan
    image = Session(Svgf(SvgfOptions(iterations=0, feedback=0))).denoise(frame.with_channels(color=color))
    assert (image[..., :36] == 0).all()
    assert (image[:, :, 2:-2, 98:100].sum(1) > 0).mean() > 0.9
    np.testing.assert_allclose(image[..., 100:], color[..., 100:], rtol=1e-5)


@pytest.mark.parametrize("make", [Svgf, Asvgf])
@pytest.mark.parametrize("start", [0, 3])
def test_a_block_that_tells_nothing_does_not_darken_what_is_around_it(make: type[Svgf], start: int) -> None:
    """Larger than the 7×7 pixels by which single ones are filled; with a history or in a first frame."""
    size, block = (64, 96), (..., slice(20, 46), slice(30, 62))
    channels = still_channels(size) | {"gradient": np.full((1, 2, *size), np.nan, np.float32)}
    channels |= {"reference": np.full((1, 3, *size), 0.5, np.float32), "albedo": np.ones((1, 3, *size), np.float32)}
    channels |= {"normal": np.broadcast_to(np.float32([0, 0.6, 0.8]).reshape(1, 3, 1, 1), (1, 3, *size))}
    channels |= {"depth": np.full((1, 1, *size), 5, np.float32)}
    frames = noisy_frames(start + 1, channels)
    color = frames[start]["color"].copy()
    color[block] = np.nan
    expected, broken = Session(make()), Session(make())
    for frame in frames[:start]:
        expected.denoise(frame), broken.denoise(frame)
    clean, image = expected.denoise(frames[start]), broken.denoise(frames[start].with_channels(color=color))
    assert image[block].mean() == pytest.approx(clean[block].mean(), rel=0.1)
    outside = np.ones(image.shape, bool)
    outside[block] = False
    assert image[outside].mean() == pytest.approx(clean[outside].mean(), rel=0.01)
