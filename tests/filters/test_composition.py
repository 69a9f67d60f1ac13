"""Composition: components denoised apart and put together."""

import numpy as np
import pytest

from nte.denoiser import Session, require_channels
from nte.errors import NteError
from nte.filters.composition import Composition
from nte.filters.taa import Taa
from nte.frames.channels import COMPONENTS
from nte.frames.frame import Frame
from nte.registry import load_denoiser
from tests.filters.sequences import still_channels


def component_frames(count: int, noise: float = 0.0) -> tuple[list[Frame], np.ndarray]:
    """Frames of a still scene with components, and their colour without noise."""
    base = still_channels()
    rng = np.random.default_rng(0)
    shape = base["color"].shape
    clean = {name: rng.random(shape, np.float32) for name in ("direct", "emission")}
    clean["glossy"] = np.full(shape, 0.2, np.float32)
    clean["indirect"] = base["albedo"] * np.float32(0.3)
    clean["visibility"] = np.full((1, 1, *shape[2:]), 0.5, np.float32)
    frames = []
    for index in range(count):
        noisy = {
            name: (clean[name] * (1 + noise * rng.choice([-1, 1], size=(1, 1, *shape[2:])))).astype(np.float32)
            for name in COMPONENTS
        }
        frames.append(Frame({**base, **clean, **noisy}, index))
    color = clean["emission"] + clean["direct"] * clean["visibility"] + clean["glossy"] + clean["indirect"]
    return frames, color


@pytest.mark.parametrize(
    "spec", ["taa:clamp=none,target=components", "svgf:target=components", "svgf:alpha=0.2,target=components"]
)
def test_the_parts_make_the_whole_and_are_extras(spec: str) -> None:
    denoiser = load_denoiser(spec)
    assert isinstance(denoiser, Composition)
    frames, color = component_frames(3)
    session = Session(denoiser)
    for frame in frames:
        result = session.step(frame, COMPONENTS)
        np.testing.assert_allclose(result.image, color, rtol=1e-4)
        for name in COMPONENTS:
            np.testing.assert_allclose(result.extras[name], frame[name], rtol=1e-4)


def test_noise_of_every_component_is_filtered() -> None:
    frames, color = component_frames(12, noise=0.8)
    session = Session(load_denoiser("svgf:target=components"))
    errors = [np.abs(session.denoise(frame) - color).mean() for frame in frames]
    noisy = frames[-1]
    given = noisy["emission"] + noisy["direct"] * noisy["visibility"] + noisy["glossy"] + noisy["indirect"]
    assert errors[-1] < 0.2 * np.abs(given - color).mean()


def test_missing_components_and_wrong_parts_are_named() -> None:
    denoiser = load_denoiser("svgf:target=components")
    with pytest.raises(NteError, match="Composition needs direct, visibility, glossy, indirect, which is missing"):
        require_channels(denoiser, still_channels(), "clip")
    with pytest.raises(NteError, match="composition: expected a denoiser for each of visibility, glossy, indirect"):
        Composition({"visibility": Taa()})
    frames, _ = component_frames(1)
    with pytest.raises(NteError, match="Composition has no extra 'color'; it has visibility, glossy, indirect"):
        denoiser.step(frames[0], None, ("color",))
    with pytest.raises(NteError, match="taa: target is 'depth'"):
        load_denoiser("taa:target=depth")
