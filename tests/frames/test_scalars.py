"""Exposure and depth scale: two numbers of a sequence that its first frame gives."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nte.errors import NteError
from nte.frames.frame import Frame
from nte.frames.scalars import estimate_exposure, median_depth, sequence_exposure, sequence_scalars
from tests.synthetic import random_frames


def constant(value: float, batch: int = 1, size: tuple[int, int] = (19, 23)) -> np.ndarray:
    return np.full((batch, 3, *size), value, np.float32)


@given(st.floats(1e-6, 1e6), st.integers(1, 30), st.integers(1, 30))
def test_a_constant_image_is_exposed_to_middle_grey(light: float, height: int, width: int) -> None:
    assert estimate_exposure(constant(light, size=(height, width))) == pytest.approx(0.18 / light, rel=1e-4)


def test_it_is_luminance_that_counts() -> None:
    green = constant(0)
    green[:, 1] = 1
    assert estimate_exposure(green) == pytest.approx(0.18 / 0.7152, rel=1e-5)


def test_two_halves_are_averaged_in_the_logarithm() -> None:
    image = constant(1.0, size=(16, 16))
    image[..., 8:] = 100
    assert estimate_exposure(image) == pytest.approx(0.18 / 10, rel=1e-5)


def test_it_measures_the_light_and_not_the_noise() -> None:
    rng = np.random.default_rng(0)
    # A light sample in every tenth pixel, ten times as bright: the mean is 1.
    samples = (rng.random((1, 1, 128, 128)) < 0.1) * 10.0
    noisy = (constant(1, size=(128, 128)) * samples).astype(np.float32)
    assert estimate_exposure(noisy) == pytest.approx(0.18, rel=0.1)


def test_black_pixels_and_bad_ones_count_as_no_light() -> None:
    assert estimate_exposure(constant(0)) == 1
    assert estimate_exposure(constant(np.nan)) == 1
    image = constant(1.0, size=(16, 16))
    for bad in (np.nan, np.inf, -np.inf, -5):
        image[..., :8] = bad
        assert estimate_exposure(image) == pytest.approx(0.18)


def test_it_is_finite_and_positive_for_the_brightest_and_the_darkest() -> None:
    for light in (3e38, 1e-30):
        exposure = estimate_exposure(constant(light))
        assert np.isfinite(exposure).all()
        assert (exposure > 0).all()


def test_every_sequence_of_a_batch_has_its_own() -> None:
    image = constant(1.0, batch=2)
    image[1] *= 4
    assert estimate_exposure(image) == pytest.approx([0.18, 0.045])


def test_a_sequence_that_restarts_has_the_exposure_of_its_own_first_frame() -> None:
    frame = Frame({"color": np.concatenate([constant(0.9), constant(90.0)])}, reset=np.array([0, 1], np.float32))
    carried = np.array([0.5, 0.5], np.float32)
    np.testing.assert_allclose(sequence_exposure(frame, carried), [0.5, 0.18 / 90], rtol=1e-4)
    np.testing.assert_allclose(sequence_exposure(frame.torch(), carried), [0.5, 0.18 / 90], rtol=1e-4)
    np.testing.assert_array_equal(sequence_exposure(replace(frame, reset=None), carried), carried)


def test_an_exposure_that_a_frame_gives_takes_the_place_of_the_carried_one() -> None:
    frame = Frame({"color": constant(1.0, batch=2)}, exposure=np.array([3.0], np.float32))
    assert sequence_exposure(frame, np.array([0.5, 0.5], np.float32)).tolist() == [3, 3]


def test_the_depth_scale_is_the_median_of_what_is_hit() -> None:
    depth = np.zeros((3, 1, 4, 5), np.float32)
    depth[0, 0, 0, :3] = 2, 3, 7
    depth[1, 0, 0, :3] = np.inf, np.nan, 5
    depth[2, 0, 0, 0] = np.inf  # sky as others write it
    assert median_depth(depth).tolist() == [3, 5, 1]


def test_what_a_frame_has_is_taken_and_the_rest_estimated() -> None:
    frame = Frame({"color": constant(1, batch=2)})
    exposure, depth_scale = sequence_scalars(frame)
    assert exposure == pytest.approx([0.18, 0.18])
    assert depth_scale.tolist() == [1, 1]
    given_exposure = replace(frame, exposure=np.array([3.0], np.float32))
    assert sequence_scalars(given_exposure)[0].tolist() == [3, 3]
    assert sequence_scalars(replace(frame, exposure=0.5))[0].tolist() == [0.5, 0.5]


def test_numpy_and_pytorch_give_the_same_bits() -> None:
    (frame,) = random_frames(1, batch=2)
    for ours, theirs in zip(sequence_scalars(frame), sequence_scalars(frame.torch()), strict=True):
        np.testing.assert_array_equal(ours, theirs)
        assert isinstance(theirs, np.ndarray)


@pytest.mark.parametrize("name", ["exposure", "depth_scale"])
@pytest.mark.parametrize("value", [0, -1, np.nan, np.inf, [1, 2, 3]])
def test_numbers_that_cannot_be_are_refused(name: str, value: object) -> None:
    frame = replace(random_frames(1, batch=2)[0], **{name: np.array(value, np.float32)})
    with pytest.raises(NteError, match=f"frame 0: {name} is .*, expected a positive number"):
        sequence_scalars(frame)
