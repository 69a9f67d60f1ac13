"""The post-process blurs that motion_blur is compared with."""

import numpy as np
import pytest
import torch

from nte.errors import NteError
from nte.filters.mcguire import McGuire, McGuireOptions, dominant_motion
from nte.filters.post_blur import PostBlur, PostBlurOptions
from nte.frames.frame import Frame
from tests.filters.sequences import run


def sharp(velocity=(12.0, 0.0), size=(60, 80), bar=(30, 50)):
    """A bright bar that moves before a dark wall, as it stands at mid-shutter."""
    x = np.indices(size)[1]
    inside = (x >= bar[0]) & (x < bar[1])
    channels = {
        "color": np.where(inside, 1.0, 0.2) * np.ones((1, 3, 1, 1)),
        "depth": np.where(inside, 2.0, 6.0)[None, None],
        "shutter_motion": np.where(inside, np.reshape(velocity, (2, 1, 1)), 0.0)[None],
    }
    return Frame({name: values.astype(np.float32) for name, values in channels.items()})


@pytest.mark.parametrize("denoiser", [PostBlur(), McGuire()])
def test_what_stands_is_unchanged(denoiser):
    frame = sharp(velocity=(0.0, 0.0))
    np.testing.assert_array_equal(run(denoiser, [frame])[0], frame["color"])


def test_own_vector_blurs_inwards_only():
    image = run(PostBlur(), [sharp()])[0][0, 0, 30]
    assert np.ptp(image[:30]) == 0
    assert np.ptp(image[50:]) == 0
    assert image[30] < 0.7
    assert image[39] == pytest.approx(1)
    assert (np.diff(image[30:37]) > 0).all()


def test_a_moving_picture_is_averaged_over_its_way():
    frame = sharp(velocity=(8.0, 0.0), bar=(0, 80))
    ramp = np.linspace(0, 1, 80, dtype=np.float32) * np.ones((1, 3, 60, 1), np.float32)
    image = run(PostBlur(), [frame.with_channels(color=ramp)])[0]
    np.testing.assert_allclose(image[..., 6:-6], ramp[..., 6:-6], atol=1e-5)  # the mean of a ramp is its middle


def test_mcguire_blurs_outwards_too():
    image = run(McGuire(), [sharp()])[0][0, 0]
    mean = image.mean(0)
    assert mean[26:30].min() > 0.25
    assert mean[:20].max() == pytest.approx(0.2)
    assert mean[40] == pytest.approx(1)
    assert (np.diff(mean[22:36]) > -0.02).all()


def test_what_is_behind_does_not_blur_over_what_stands_in_front():
    frame = sharp()
    behind = frame.with_channels(depth=np.where(frame["depth"] == 2, 6, 2).astype(np.float32))
    np.testing.assert_allclose(run(McGuire(), [behind])[0][0, :, :, 50:], 0.2, atol=1e-5)


@pytest.mark.parametrize("unit", [2.0**-30, 2.0**30])
def test_the_sky_is_behind_everything_in_any_unit_of_length(unit):
    """A wall that stands before a sky that moves keeps its colour."""
    frame = sharp()
    x = np.indices(frame.size)[1]
    moving = np.where(x < 50, np.reshape([12.0, 0.0], (2, 1, 1)), 0.0)[None].astype(np.float32)
    depth = np.where(x < 50, 0.0, 2 * unit)[None, None].astype(np.float32)
    image = run(McGuire(), [frame.with_channels(depth=depth, shutter_motion=moving)])[0]
    np.testing.assert_allclose(image[..., 50:], frame["color"][..., 50:], atol=1e-5)


def test_dominant_motion_is_the_longest_of_nine_tiles():
    half = torch.zeros(1, 2, 50, 50)
    half[0, :, 25, 25] = torch.tensor([3.0, 4.0])
    half[0, 0, 26, 26] = 4.0
    found = dominant_motion(half, 10)
    assert (found[0, 0, 10:40, 10:40] == 3).all()
    assert (found[0, 1, 10:40, 10:40] == 4).all()
    assert not found[..., :10, :].any()
    assert not found[..., 40:].any()


@pytest.mark.parametrize("denoiser", [PostBlur(), McGuire(McGuireOptions(tile=7))])
@pytest.mark.parametrize("size", [(1, 1), (3, 5), (41, 23)])
def test_any_size_and_bad_pixels(denoiser, size):
    frame = sharp(size=size, bar=(0, 3), velocity=(1e5, 3.0))
    for name in frame.channels:
        frame[name][..., 0, 0] = np.nan
    assert np.isfinite(denoiser.step(frame, None)[0].image).all()


def test_options_out_of_range_are_refused():
    with pytest.raises(NteError, match="post_blur: samples is 0"):
        PostBlur(PostBlurOptions(samples=0))
    with pytest.raises(NteError, match="mcguire: tile is 0"):
        McGuire(McGuireOptions(tile=0))
