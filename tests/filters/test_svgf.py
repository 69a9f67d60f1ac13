"""SVGF: accumulation, variance and edge-stopping, on frames whose truth is known."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from nte.denoiser import Denoiser
from nte.errors import NteError
from nte.filters.asvgf import Asvgf, AsvgfOptions
from nte.filters.svgf import Svgf, SvgfOptions
from nte.frames.frame import Frame
from nte.registry import load_denoiser
from nte.session import Session
from tests.filters.sequences import noisy_frames, run, still_channels
from tests.synthetic import disc_frame, random_channels

FILTERS = (Svgf, Asvgf)


def without_gradient(frames: list[Frame]) -> list[Frame]:
    """A-SVGF's channel, with no sample in it: A-SVGF is SVGF with another α then."""
    unknown = np.full_like(frames[0]["motion"], np.nan)
    return [frame.with_channels(gradient=unknown) for frame in frames]


def rmse(image: np.ndarray, reference: np.ndarray) -> float:
    return float(np.sqrt(np.mean((image - reference) ** 2)))


@pytest.mark.parametrize("make", FILTERS)
def test_the_error_of_a_static_scene_falls_like_that_of_a_running_mean(make: type[Svgf]) -> None:
    channels = still_channels()
    frames = without_gradient(noisy_frames(16, channels))
    images = run(make(make.options_type(alpha=0.01, iterations=0, feedback=0, history=100)), frames)
    mean = np.cumsum([frame["color"] for frame in frames], 0) / np.arange(1, 17).reshape(-1, 1, 1, 1, 1)
    for image, expected in zip(images, mean, strict=True):
        np.testing.assert_allclose(image, expected, rtol=1e-3, atol=1e-4)
    errors = [rmse(image, channels["reference"]) for image in images]
    assert errors[15] == pytest.approx(errors[0] / 4, rel=0.15)


@pytest.mark.parametrize("make", FILTERS)
@pytest.mark.parametrize("alpha", [0.1, 0.3])
def test_the_error_falls_until_the_floor_of_alpha(make: type[Svgf], alpha: float) -> None:
    channels = still_channels(size=(48, 64))
    images = run(
        make(make.options_type(alpha=alpha, iterations=0, feedback=0)), without_gradient(noisy_frames(40, channels))
    )
    mean = np.mean([((image / channels["reference"]) - 1) ** 2 for image in images[30:]])
    assert mean == pytest.approx(alpha / (2 - alpha), rel=0.12)  # of an exponential mean of noise of variance 1


@pytest.mark.parametrize("make", FILTERS)
def test_filtering_in_space_helps_from_the_first_frame_on_and_time_helps_further(make: type[Svgf]) -> None:
    channels = still_channels()
    images = run(make(), without_gradient(noisy_frames(24, channels)))
    noise = rmse(noisy_frames(1, channels)[0]["color"], channels["reference"])
    errors = [rmse(image, channels["reference"]) for image in images]
    assert errors[0] < noise / 4
    assert errors[-1] < errors[0] / 2


@pytest.mark.parametrize("make", FILTERS)
def test_a_white_environment_stays_white_whatever_the_albedo(make: type[Svgf]) -> None:
    rng = np.random.default_rng(1)
    frames = []
    for index in range(4):
        channels = random_channels(rng)
        channels["color"] = channels["albedo"].copy()  # what a white furnace reflects
        frames.append(Frame(channels, index))
    for frame, image in zip(frames, run(make(), without_gradient(frames)), strict=True):
        np.testing.assert_allclose(image / frame["albedo"], 1, rtol=1e-5)


def test_indirect_light_is_divided_by_what_the_diffuse_lobe_reflects() -> None:
    """Its texture passes unfiltered, though the albedo, which counts glossy lobes too, has another."""
    rng = np.random.default_rng(3)
    channels = random_channels(rng, size=(20, 31))
    diffuse = rng.uniform(0.1, 0.9, channels["albedo"].shape).astype(np.float32)
    channels |= {"diffuse_albedo": diffuse, "indirect": 0.7 * diffuse}
    for spec in ("svgf:target=indirect", "asvgf:target=indirect", "align_accumulate:target=indirect,demodulate=true"):
        for image in run(load_denoiser(spec), without_gradient([Frame(channels, index) for index in range(3)])):
            np.testing.assert_allclose(image, channels["indirect"], rtol=1e-4)


@pytest.mark.parametrize("make", FILTERS)
def test_emission_passes_unfiltered_and_its_edges_do_not_brighten(make: type[Svgf]) -> None:
    channels = still_channels()
    rng = np.random.default_rng(0)
    channels["emission"] = 5 * rng.random(channels["color"].shape, np.float32)
    channels["color"] = channels["emission"]
    for image in run(make(), without_gradient([Frame(channels, i) for i in range(3)])):
        np.testing.assert_allclose(image, channels["emission"], atol=1e-5)


@pytest.mark.parametrize("make", FILTERS)
def test_zero_motion_moves_no_pixel(make: type[Svgf]) -> None:
    channels = still_channels()
    for image in run(
        make(make.options_type(iterations=0, feedback=0)), without_gradient([Frame(channels, i) for i in range(8)])
    ):
        np.testing.assert_allclose(image, channels["color"], rtol=1e-5)


def test_history_length_counts_frames_and_stops_at_its_limit_and_alpha_at_its_floor() -> None:
    session = Session(Svgf(SvgfOptions(alpha=0.3, history=5)))
    for index, frame in enumerate(noisy_frames(8, still_channels(size=(9, 7)))):
        extras = session.step(frame, ("history_length", "alpha")).extras
        np.testing.assert_allclose(extras["history_length"], min(index + 1, 5), rtol=1e-6)
        np.testing.assert_allclose(extras["alpha"], max(0.3, 1 / min(index + 1, 5)), rtol=1e-6)


def test_a_disc_that_moves_by_half_pixels_keeps_its_history() -> None:
    session = Session(Svgf())
    for index in range(5):
        channels = disc_frame(index, velocity=(3.5, 0.0))
        length = session.step(Frame({k: v[None] for k, v in channels.items()}, index), ("history_length",))
    disc = channels["instance"][None] == 2
    found = length.extras["history_length"]
    assert np.median(found[disc]) == 5
    assert found[disc].min() >= 2
    assert (found[~disc] == 1).any()  # uncovered wall


def two_sides(kind: str) -> dict[str, np.ndarray]:
    """The right half is four times as bright, and differs in normal or in depth."""
    height, width = 20, 24
    right = np.broadcast_to(np.arange(width) >= 11, (1, 1, height, width))
    channels = {
        "reference": np.repeat(np.where(right, 4, 1), 3, 1),
        "albedo": np.ones((1, 3, height, width)),
        "normal": np.concatenate([right, 0 * right, ~right], 1)
        if kind == "normal"
        else np.zeros((1, 3, height, width)),
        "depth": np.where(right & (kind == "depth"), 9.0, 3.0),
        "motion": np.zeros((1, 2, height, width)),
    }
    if kind == "depth":
        channels["normal"][:, 2] = 1
    channels["color"] = channels["reference"]
    return {name: values.astype(np.float32) for name, values in channels.items()}


@pytest.mark.parametrize("kind", ["normal", "depth"])
def test_nothing_crosses_an_edge_between_surfaces_however_noisy(kind: str) -> None:
    channels = two_sides(kind)
    images = run(Svgf(), noisy_frames(12, channels))
    right = channels["reference"][0, 0] == 4
    assert images[-1][0, 0][~right].max() < 1.7
    assert images[-1][0, 0][right].min() > 2.3


@pytest.mark.parametrize("make", FILTERS)
@pytest.mark.parametrize("length", [0.5, 0.98, 1.009])
def test_normals_of_another_length_filter_as_unit_vectors_do(make: type[Svgf], length: float) -> None:
    """Averaged over a pixel, or rounded to 8 bits, they are too short; their direction is what counts."""
    channels = still_channels((24, 36)) | {"gradient": np.full((1, 2, 24, 36), np.nan, np.float32)}
    other = channels | {"normal": channels["normal"] * np.float32(length)}
    pairs = zip(noisy_frames(3, channels), noisy_frames(3, other), strict=True)
    for expected, found in zip(*(run(make(), frames) for frames in zip(*pairs, strict=True)), strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-3, atol=1e-5)


@pytest.mark.parametrize("make", FILTERS)
def test_a_reset_is_a_new_start_bit_for_bit(make: type[Svgf]) -> None:
    frames = without_gradient(noisy_frames(5, still_channels(batch=2)))
    frames[3] = replace(frames[3], reset=np.array([0, 1], np.float32))
    with_reset, anew = run(make(), frames), run(make(), frames[3:])
    through = run(make(), [replace(frame, reset=None) for frame in frames])
    for index in (3, 4):
        np.testing.assert_array_equal(with_reset[index][1], anew[index - 3][1])
        np.testing.assert_array_equal(with_reset[index][0], through[index][0])
    assert not np.array_equal(with_reset[4][0], anew[1][0])


@pytest.mark.parametrize("make", FILTERS)
def test_a_batch_is_its_sequences_side_by_side(make: type[Svgf]) -> None:
    rng = np.random.default_rng(3)
    frames = without_gradient([Frame(random_channels(rng, (13, 17), batch=3), index) for index in range(3)])
    together = run(make(), frames)
    for n in range(3):
        alone = [Frame({k: v[n : n + 1] for k, v in f.channels.items()}, f.index) for f in frames]
        for image, single in zip(together, run(make(), alone), strict=True):
            np.testing.assert_allclose(image[n], single[0], rtol=1e-4, atol=1e-5)


@settings(max_examples=15, deadline=None)
@given(st.integers(1, 14), st.integers(1, 14), st.sampled_from(FILTERS), st.sampled_from(("random", "sky", "dot")))
def test_any_size_and_any_frame_gives_finite_light(height: int, width: int, make: type[Svgf], kind: str) -> None:
    rng = np.random.default_rng(height)
    frames = []
    for index in range(3):
        channels = random_channels(rng, (height, width))
        if kind != "random":
            seen = np.zeros((1, 1, height, width), np.float32)
            seen[..., height // 2, width // 2] = kind == "dot"
            channels |= {name: channels[name] * seen for name in ("depth", "normal", "albedo")}
        frames.append(Frame(channels, index))
    for frame, image in zip(frames, run(make(), without_gradient(frames)), strict=True):
        assert image.shape == frame["color"].shape
        assert np.isfinite(image).all()
        assert image.min() >= 0


@pytest.mark.filterwarnings("ignore::nte.frames.bad.BadPixelWarning")
def test_bad_pixels_spoil_nothing() -> None:
    frames = noisy_frames(4, still_channels())
    for name, values in frames[1].channels.items():
        spoilt = values.copy()
        for at, bad in enumerate((np.nan, np.inf, -np.inf, -1e9)):
            spoilt[0, :, 5, 5 + at] = bad
        frames[1] = frames[1].with_channels(**{name: spoilt})
    images = run(Svgf(), frames)
    assert all(np.isfinite(image).all() for image in images)
    assert rmse(images[3], frames[3]["reference"]) < 0.5


def test_scalar_visibility_is_filtered_as_an_image_of_one_channel() -> None:
    channels = still_channels()
    rng = np.random.default_rng(0)
    frames = []
    for index in range(12):
        lit = (rng.random(channels["depth"].shape) < 0.5).astype(np.float32)
        frames.append(Frame({**channels, "visibility": lit}, index))
    denoiser: Denoiser = Svgf(SvgfOptions(target="visibility"))
    assert "albedo" not in denoiser.needs
    image = run(denoiser, frames)[-1]
    assert image.shape == (1, 1, 24, 32)
    assert np.abs(image - 0.5).mean() < 0.06


def test_torch_in_torch_out_with_the_same_numbers() -> None:
    frames = noisy_frames(3, still_channels(size=(12, 12)))
    ours, theirs = run(Svgf(), frames), run(Svgf(), [frame.torch() for frame in frames])
    assert isinstance(theirs[-1], torch.Tensor)
    np.testing.assert_array_equal(ours[-1], np.asarray(theirs[-1]))


def test_what_does_not_fit_is_named() -> None:
    for wrong, message in (
        ({"target": "albedo"}, "svgf: target is 'albedo', expected one of color, visibility"),
        ({"alpha": 0.0}, r"svgf: alpha is 0.0, expected a weight of the current frame in \(0, 1\]"),
        ({"feedback": 6}, "svgf: feedback is 6, expected 0 to iterations, which is 5"),
        ({"history": 0.5}, "svgf: history is 0.5, expected a number of frames, 1 or more"),
        ({"sigma_z": -1.0}, "svgf: sigma_z is -1.0, expected a finite number above 0"),
    ):
        with pytest.raises(NteError, match=message):
            Svgf(SvgfOptions(**wrong))  # type: ignore[arg-type]
    with pytest.raises(NteError, match="asvgf: gradient_iterations is -1"):
        Asvgf(AsvgfOptions(gradient_iterations=-1))
    with pytest.raises(NteError, match="asvgf: gradient_noise is -1"):
        Asvgf(AsvgfOptions(gradient_noise=-1))
    frames = noisy_frames(1, still_channels(size=(8, 8)))
    with pytest.raises(NteError, match="Svgf has no extra 'mask', expected one of history_length, alpha, variance"):
        Svgf().step(frames[0], None, ("mask",))
    _, state = Svgf().step(frames[0], None)
    with pytest.raises(NteError, match=r"\(1, 9, 8\) after \(1, 8, 8\): start a new sequence"):
        Svgf().step(noisy_frames(1, still_channels(size=(9, 8)))[0], state)
