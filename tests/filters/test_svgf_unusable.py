"""Pixels that tell nothing, in SVGF and A-SVGF: what is around them speaks for them."""

import numpy as np
import pytest

from nte.denoiser import Session
from nte.filters.asvgf import Asvgf
from nte.filters.svgf import Svgf, SvgfOptions
from nte.frames.frame import Frame
from tests.filters.sequences import noisy_frames, still_channels


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
    frame = noisy_frames(1, still_channels((20, 40)))[0]
    color = frame["color"].copy()
    color[..., :20] = np.nan
    image = Session(Svgf(SvgfOptions(iterations=0, feedback=0))).denoise(frame.with_channels(color=color))
    assert (image[..., :17] == 0).all()
    assert (image[:, :, 2:-2, 18:20].sum(1) > 0).mean() > 0.9  # the mean over 7×7 reaches three pixels
    np.testing.assert_allclose(image[..., 20:], color[..., 20:], rtol=1e-5)
