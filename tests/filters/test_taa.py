"""TAA: an exponential mean along motion vectors, with history kept in check."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from nte.errors import NteError
from nte.filters.taa import Taa, TaaOptions
from nte.frames.frame import Frame
from nte.session import Session
from tests.synthetic import disc_frame, random_channels

CLAMPS = TaaOptions.choices("clamp")


def still(color: np.ndarray, index: int = 0) -> Frame:
    """A frame (1, 3, H, W) in which nothing moves."""
    return Frame({"color": color, "motion": np.zeros((1, 2, *color.shape[2:]), np.float32)}, index)


def noise(count: int, size: int = 48) -> np.ndarray:
    return np.random.default_rng(0).exponential(size=(count, 1, 3, size, size)).astype(np.float32)


def run(denoiser: Taa, frames: list[Frame]) -> list[np.ndarray]:
    session = Session(denoiser)
    return [session.denoise(frame) for frame in frames]


@pytest.mark.parametrize("alpha", [0.1, 0.5, 1.0])
def test_without_clamping_it_is_the_exponential_mean(alpha: float) -> None:
    colors = noise(6, size=9)
    images = run(Taa(TaaOptions("none", alpha)), [still(color) for color in colors])
    mean = colors[0]
    np.testing.assert_array_equal(images[0], mean)
    for color, image in zip(colors[1:], images[1:], strict=True):
        mean = alpha * color + (1 - alpha) * mean
        np.testing.assert_allclose(image, mean, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("alpha", [0.1, 0.3])
def test_the_variance_of_noise_falls_to_alpha_over_two_minus_alpha(alpha: float) -> None:
    images = run(Taa(TaaOptions("none", alpha)), [still(c) for c in noise(60)])
    assert np.var(images[-1]) == pytest.approx(alpha / (2 - alpha), rel=0.1)
    assert np.mean(images[-1]) == pytest.approx(1, rel=0.02)


@pytest.mark.parametrize("clamp", CLAMPS)
def test_a_constant_stays_constant(clamp: str) -> None:
    color = np.full((1, 3, 12, 16), 3.0, np.float32)
    for image in run(Taa(TaaOptions(clamp)), [still(color)] * 4):
        np.testing.assert_allclose(image, color, rtol=1e-5)


def ghosts(clamp: str) -> tuple[float, float]:
    """A disc brighter than the wall moves by 4 px a frame: (error in its wake, error where it is)."""
    truth, frames = [], []
    for i in range(6):
        channels = disc_frame(i, velocity=(4.0, 0.0), radius=7.0)
        disc = channels["instance"] == 2
        channels["color"] = np.where(disc, np.float32(8), np.float32(1)).repeat(3, 0)
        truth.append((channels["color"], disc[0]))
        frames.append(Frame({name: channels[name][None] for name in ("color", "motion")}, i))
    image = run(Taa(TaaOptions(clamp)), frames)[-1][0]
    expected, disc = truth[-1]
    error = np.abs(image - expected).mean(0)
    wake = truth[-2][1] & ~disc
    return float(error[wake].mean()), float(error[disc].mean())


def test_a_moving_disc_takes_its_history_along_and_clamping_removes_its_ghost() -> None:
    wake, disc = ghosts("none")
    assert wake > 2
    assert disc < 0.05
    for clamp in ("clamp", "clip"):
        assert ghosts(clamp)[0] < 0.3 * wake


@pytest.mark.filterwarnings("ignore::nte.frames.bad.BadPixelWarning")
@pytest.mark.parametrize("clamp", CLAMPS)
def test_invalid_pixels_take_the_current_frame(clamp: str) -> None:
    before, now = (still(color, i) for i, color in enumerate(noise(2, size=12)))
    now["motion"][0, 0, 3, 4] = 50
    now["motion"][0, 1, 5, 6] = np.nan
    now["motion"][0, 1, 7, 8] = np.inf
    image = run(Taa(TaaOptions(clamp, alpha=0.1)), [before, now])[1]
    same = (image == now["color"]).all(1)[0]
    assert same[3, 4]
    assert same[5, 6]
    assert same[7, 8]
    assert same.sum() == 3


def test_clamping_keeps_history_within_the_neighbourhood_of_now() -> None:
    bright, dark = (np.full((1, 3, 8, 8), value, np.float32) for value in (9, 1))
    for clamp in ("clamp", "clip"):
        np.testing.assert_allclose(run(Taa(TaaOptions(clamp)), [still(bright), still(dark)])[1], dark, rtol=1e-4)
    assert run(Taa(TaaOptions("none", alpha=0.25)), [still(bright), still(dark)])[1] == pytest.approx(
        0.25 * 1 + 0.75 * 9
    )


@pytest.mark.filterwarnings("ignore::nte.frames.bad.BadPixelWarning")
def test_bad_pixels_count_as_black() -> None:
    color = np.ones((1, 3, 8, 8), np.float32)
    color[0, 0, 3, 3], color[0, 1, 3, 4], color[0, 2, 3, 5] = np.nan, np.inf, -4
    for clamp in CLAMPS:
        for image in run(Taa(TaaOptions(clamp)), [still(color)] * 3):
            assert np.isfinite(image).all()
            assert image.min() >= 0


def test_a_reset_starts_one_sequence_of_the_batch_anew() -> None:
    colors = np.concatenate([noise(2, size=8)] * 2, 1)
    frames = [
        Frame({"color": color, "motion": np.zeros((2, 2, 8, 8), np.float32)}, i) for i, color in enumerate(colors)
    ]
    frames[1] = replace(frames[1], reset=np.array([0, 1], np.float32))
    image = run(Taa(TaaOptions("none")), frames)[1]
    np.testing.assert_array_equal(image[1], colors[1][1])
    assert not np.allclose(image[0], colors[1][0])


@pytest.mark.parametrize("clamp", CLAMPS)
def test_a_reset_is_a_new_start_bit_for_bit(clamp: str) -> None:
    frames = [still(color, i) for i, color in enumerate(noise(5, size=8))]
    frames[2] = replace(frames[2], reset=np.ones(1, np.float32))
    for after, anew in zip(
        run(Taa(TaaOptions(clamp)), frames)[2:], run(Taa(TaaOptions(clamp)), frames[2:]), strict=True
    ):
        np.testing.assert_array_equal(after, anew)


@pytest.mark.parametrize("clamp", CLAMPS)
def test_zero_motion_moves_no_pixel_and_white_light_stays_white(clamp: str) -> None:
    # A pixel like its neighbours is within one standard deviation of them: no clamp touches a smooth picture's middle.
    color = np.broadcast_to(1 + np.arange(12, dtype=np.float32), (1, 3, 12, 12)).copy()
    for image in run(Taa(TaaOptions(clamp)), [still(color)] * 5):
        np.testing.assert_allclose(image[..., 1:-1], color[..., 1:-1], rtol=1e-5)
    for image in run(Taa(TaaOptions(clamp)), [still(np.ones_like(color))] * 5):
        np.testing.assert_array_equal(image, 1)


@settings(max_examples=12, deadline=None)
@given(st.integers(1, 7), st.integers(1, 7), st.sampled_from(CLAMPS))
def test_any_size_gives_finite_light_and_sky_stays_black(height: int, width: int, clamp: str) -> None:
    rng = np.random.default_rng(height)
    frames = [Frame(random_channels(rng, (height, width)), index) for index in range(3)]
    for frame, image in zip(frames, run(Taa(TaaOptions(clamp)), frames), strict=True):
        assert image.shape == frame["color"].shape
        assert np.isfinite(image).all()
        assert image.min() >= 0
    for image in run(Taa(TaaOptions(clamp)), [frame.with_channels(color=0 * frame["color"]) for frame in frames]):
        np.testing.assert_array_equal(image, 0)


def test_torch_in_torch_out_with_the_same_numbers() -> None:
    frames = [still(color) for color in noise(3, size=8)]
    ours, theirs = run(Taa(), frames), run(Taa(), [frame.torch() for frame in frames])
    assert isinstance(theirs[-1], torch.Tensor)
    np.testing.assert_array_equal(ours[-1], np.asarray(theirs[-1]))


def test_what_does_not_fit_is_named() -> None:
    with pytest.raises(NteError, match="taa: clamp is 'hard', expected one of none, clamp, clip"):
        Taa(TaaOptions("hard"))
    for alpha in (0, -0.1, 1.1, float("nan")):
        with pytest.raises(NteError, match=r"taa: alpha is .*, expected a weight"):
            Taa(TaaOptions(alpha=alpha))
    _, state = Taa().step(still(noise(1, size=8)[0]), None)
    with pytest.raises(NteError, match=r"frame 3: .* \(1, 9, 9\) after \(1, 8, 8\): start a new sequence"):
        Taa().step(still(noise(1, size=9)[0], 3), state)
