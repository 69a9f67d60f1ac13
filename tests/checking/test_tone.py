"""A reference that is encoded, clipped or went through a tone curve is told; a multiple of colour never is."""

from collections.abc import Callable

import numpy as np
import pytest
import torch

from nte.checking.exposure import ExposureTally
from nte.checking.values import Finding
from nte.frames.frame import Frame
from tests.checking.room import room_frame
from tests.checking.test_flips import SUN
from tests.synthetic import Pixels

Curve = Callable[[Pixels], Pixels]


def aces(x: Pixels) -> Pixels:
    return np.clip(x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14), 0, 1)


def hable(x: Pixels) -> Pixels:
    def curve(x: Pixels) -> Pixels:
        return (x * (0.15 * x + 0.05) + 0.004) / (x * (0.15 * x + 0.5) + 0.06) - 0.02 / 0.3

    return np.clip(curve(2 * x) / curve(np.float32(11.2)), 0, 1)


def reinhard(x: Pixels) -> Pixels:
    return x / (1 + x)


def srgb(x: Pixels) -> Pixels:
    x = np.clip(x, 0, 1)
    return np.where(x < 0.0031308, 12.92 * x, 1.055 * np.maximum(x, 1e-9) ** (1 / 2.4) - 0.055)


CURVES: dict[str, Curve] = {
    "aces": aces,
    "hable": hable,
    "reinhard": reinhard,
    "srgb": srgb,
    "reinhard and srgb": lambda x: srgb(reinhard(x)),
    "gamma": lambda x: x ** (1 / 2.2),
    "8 bits": lambda x: np.round(255 * srgb(x)) / 255,
    "logarithm": np.log1p,
    "clipped": lambda x: np.minimum(x, 1),
    "lifted": lambda x: x + 0.3 * x.mean(),
}
MULTIPLES: dict[str, Curve] = {
    "right": lambda x: x,
    "half": lambda x: x / 2,
    "in cd/m²": lambda x: 1e-6 * x,
    "half floats": lambda x: x.astype(np.float16).astype(np.float32),
}


def lights(spp: int = 1, reference_spp: int = 0) -> list[tuple[Pixels, Pixels]]:
    """Colour and reference (3, H, W) of the room in the sun, of frames of a camera that moves: exponential noise."""
    rng = np.random.default_rng(5)
    found = []
    for i in range(4):
        frame = room_frame(i)
        sun = np.maximum(np.einsum("i,ihw->hw", SUN, frame["normal"]), 0) + 0.2
        light = 2 * frame["albedo"] * sun + np.reshape([0.4, 0.6, 1.0], (3, 1, 1)) * (frame["depth"] == 0)
        drawn = [rng.gamma(n, 1 / n, (1, *light.shape[1:])) if n else 1.0 for n in (spp, reference_spp)]
        found.append((np.float32(light * drawn[0]), np.float32(light * drawn[1])))
    return found


def told(pairs: list[tuple[Pixels, Pixels]]) -> list[Finding]:
    tally = ExposureTally()
    for i, images in enumerate(pairs):
        both = zip(("color", "reference"), images, strict=True)
        tally.add(Frame({name: torch.tensor(np.float32(image))[None] for name, image in both}, i))
    return list(tally.judge())


@pytest.mark.parametrize("exposure", [0.5, 1.0, 4.0])
@pytest.mark.parametrize("name", CURVES)
def test_a_curve_is_a_fault(name: str, exposure: float) -> None:
    pairs = [(exposure * color, CURVES[name](exposure * reference)) for color, reference in lights()]
    if name == "clipped" and exposure < 1:
        pytest.skip("nothing is brighter than 1")
    found = told(pairs)
    assert [finding.fault for finding in found] == [True]
    # Where nearly all of it is white, one factor explains it as well.
    assert found[0].found.startswith("is no multiple of color, which is ") or exposure == 4


@pytest.mark.parametrize("name", CURVES)
def test_a_colour_with_a_curve_is_one_too(name: str) -> None:
    if name != "clipped":  # noise that is clipped is as dark as noise
        found = told([(CURVES[name](color), reference) for color, reference in lights(spp=64)])
        assert any(finding.fault and "no multiple" in finding.found for finding in found)


@pytest.mark.parametrize("reference_spp", [0, 4, 64])
@pytest.mark.parametrize("name", MULTIPLES)
def test_a_multiple_is_none(name: str, reference_spp: int) -> None:
    """However noisy the reference is: bins of one half of the pixels say nothing of the noise in the other."""
    pairs = [(color, MULTIPLES[name](reference)) for color, reference in lights(reference_spp=reference_spp)]
    assert not [finding for finding in told(pairs) if "multiple" in finding.found]


def test_fireflies_and_black_frames_bend_nothing() -> None:
    """One sample in 200 carries all light; one frame is black, one has pixels that are not numbers."""
    rng = np.random.default_rng(1)
    pairs = [(200 * reference * (rng.random(reference.shape[1:]) < 1 / 200), reference) for _, reference in lights()]
    pairs[1] = 0 * pairs[1][0], 0 * pairs[1][1]
    pairs[2][1][:, 5:9, 5:9] = np.nan
    pairs[2][0][:, 30:33, 5:9] = np.inf
    assert not [finding for finding in told(pairs) if "multiple" in finding.found]


def test_a_picture_of_one_brightness_shows_no_curve_and_says_so() -> None:
    flat = np.full((3, 32, 32), 0.4, np.float32)
    tally = ExposureTally()
    noisy = flat * np.random.default_rng(0).exponential(size=(1, 32, 32)).astype(np.float32)
    tally.add(Frame({"color": torch.tensor(noisy)[None], "reference": torch.tensor(flat)[None]}, 0))
    assert "2 are needed to see a tone curve" in tally.not_judged()


@pytest.mark.parametrize("spp", [1, 4, 16])
def test_noise_that_neighbours_share_bends_nothing(spp: int) -> None:
    """A reference of few samples, each of which counts in the pixels around its own as well."""
    rng = np.random.default_rng(9)
    pairs = []
    for _, light in lights():
        images = []
        for samples in (1, spp):
            image = light * rng.gamma(samples, 1 / samples, (1, *light.shape[1:]))
            for axis in (1, 2):
                image = 0.25 * np.roll(image, -1, axis) + 0.5 * image + 0.25 * np.roll(image, 1, axis)
            images.append(np.float32(image))
        pairs.append((images[0], images[1]))
    assert not [finding for finding in told(pairs) if "multiple" in finding.found]
