"""The noise model, fitted to noise that is known."""

import pytest
import torch

from nte.burst.noise import NoiseModel, fit_noise
from nte.errors import NteError
from tests.burst.scenes import NOISE, PATTERNS, mosaic_of, scene, sense


def signals(frame: torch.Tensor) -> torch.Tensor:
    """From the dark to the bright parts of a picture: beyond, there is nothing to fit to."""
    return frame.flatten()[::7].quantile(torch.tensor([0.05, 0.25, 0.5, 0.75, 0.95]))


@pytest.mark.parametrize("kind", [*PATTERNS, "rgb"])
@pytest.mark.parametrize("known", [NoiseModel(0.002, 1e-4), NoiseModel(0.008, 1e-3), NoiseModel(0.0, 1e-3)], ids=str)
def test_the_fit_is_within_10_percent_in_a_picture_that_moves(kind: str, known: NoiseModel) -> None:
    mosaic = None if kind == "rgb" else mosaic_of(kind)
    frames = [sense(scene((480, 640), shift), mosaic, known, seed) for seed, shift in enumerate([(0, 0), (3.3, -1.7)])]
    found = fit_noise(*frames, mosaic)
    signal = signals(frames[0])
    torch.testing.assert_close(found.variance(signal), known.variance(signal), rtol=0.1, atol=0)


@pytest.mark.parametrize("kind", ["bayer", "rgb"])
@pytest.mark.parametrize("light", [10.0, 1e4, 1e12])
def test_a_bright_speck_in_one_frame_is_no_noise(kind: str, light: float) -> None:
    """A firefly: what is flat in the other frame measures nothing there."""
    mosaic = None if kind == "rgb" else mosaic_of(kind)
    frames = [sense(scene((240, 320), (i, 0)), mosaic, NOISE, i) for i in range(2)]
    frames[1][..., 70, 100] = light
    found, signal = fit_noise(*frames, mosaic, clips=False), signals(frames[0])
    torch.testing.assert_close(found.variance(signal), NOISE.variance(signal), rtol=0.2, atol=0)


@pytest.mark.parametrize("kind", PATTERNS)
def test_a_gradient_is_no_noise(kind: str) -> None:
    mosaic, known = mosaic_of(kind), NoiseModel(0.001, 1e-4)
    ramp = torch.linspace(0.05, 0.9, 480).expand(1, 3, 360, 480) * torch.tensor([0.5, 1.0, 0.8]).view(1, 3, 1, 1)
    frames = [sense(ramp, mosaic, known, seed) for seed in range(2)]
    found, signal = fit_noise(*frames, mosaic), signals(ramp)
    torch.testing.assert_close(found.variance(signal), known.variance(signal), rtol=0.1, atol=0)


def test_saturated_light_has_no_noise_to_fit() -> None:
    white = torch.ones(1, 1, 128, 128)
    with pytest.raises(NteError, match="give --noise"):
        fit_noise(white, white, mosaic_of("bayer"))


def test_frames_without_noise_give_the_least_that_there_can_be() -> None:
    grey = torch.full((1, 1, 128, 128), 0.3)
    found = fit_noise(grey, grey, mosaic_of("bayer"))
    assert 0 < float(found.variance(torch.tensor(0.3))) <= 1e-9


@pytest.mark.parametrize(("a", "b"), [(-1, 1), (1, -1), (0, 0), (float("nan"), 1)])
def test_a_model_that_cannot_be_is_refused(a: float, b: float) -> None:
    with pytest.raises(NteError, match="noise model"):
        NoiseModel(a, b)
