"""Composition: components denoised apart and put together."""

from pathlib import Path

import numpy as np
import pytest

from nte.config import to_yaml
from nte.denoiser import require_channels
from nte.errors import NteError
from nte.filters.composition import Composition
from nte.filters.taa import Taa
from nte.frames.channels import COMPONENTS
from nte.frames.frame import Frame
from nte.registry import load_denoiser
from nte.session import Session
from nte.training.checkpoint import module_state, write_checkpoint
from nte.training.config import DataConfig, PhaseConfig, TrainConfig
from tests.everything import floor_frame
from tests.filters.sequences import still_channels
from tests.tiny_network import TinyConfig, TinyNetwork


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
    with pytest.raises(NteError, match="Composition has no extra 'color', expected one of visibility, glossy, ind"):
        denoiser.step(frames[0], None, ("color",))
    with pytest.raises(NteError, match="taa: target is 'depth'"):
        load_denoiser("taa:target=depth")


LIGHTS = "composite:visibility={},glossy={},indirect={}"


@pytest.mark.parametrize(
    ("spec", "parts"),
    [
        (LIGHTS.format("trmv", "svgf", "taa"), ("trmv:target=visibility", "svgf:target=glossy", "taa:target=indirect")),
        (
            "composite:indirect=[svgf:alpha=0.2,young=2],visibility=[taa:clamp=none,target=visibility],glossy=asvgf",
            ("taa:clamp=none,target=visibility", "asvgf:target=glossy", "svgf:alpha=0.2,young=2,target=indirect"),
        ),
        # Options of the filters that have the names of lights.
        (
            LIGHTS.format("[trmv:glossy=none,indirect=colour]", "[trmv:indirect=cones,preset=specular]", "[taa]"),
            (
                "trmv:target=visibility,glossy=none,indirect=colour",
                "trmv:target=glossy,indirect=cones,preset=specular", "taa:target=indirect",
            ),
        ),
    ],
)  # fmt: skip
def test_a_composite_is_the_sum_of_what_each_lights_denoiser_makes_of_it(spec: str, parts: tuple[str, ...]) -> None:
    composite, apart = Session(load_denoiser(spec)), [Session(load_denoiser(part)) for part in parts]
    frames = [floor_frame(index) for index in range(3)]
    for frame in frames:
        result = composite.step(frame, COMPONENTS)
        images = dict(zip(COMPONENTS, (session.denoise(frame) for session in apart), strict=True))
        for name in COMPONENTS:
            np.testing.assert_array_equal(result.extras[name], images[name])
        light = frame["direct"] * images["visibility"] + images["glossy"] + images["indirect"] + frame["emission"]
        np.testing.assert_allclose(result.image, light, rtol=1e-5, atol=1e-6)


def test_a_composite_reads_only_what_its_denoisers_read() -> None:
    composite = load_denoiser(LIGHTS.format("trmv", "taa", "taa"))
    assert "shadow_motion" in composite.needs
    assert not {"color", "reflection_motion", "reflection_covariance", "indirect_radiance"} & {*composite.needs}


def test_one_light_of_trmv_is_that_of_the_whole_system() -> None:
    whole, alone = Session(load_denoiser("trmv")), Session(load_denoiser(LIGHTS.format("trmv", "trmv", "trmv")))
    for index in range(3):
        frame = floor_frame(index)
        ours, theirs = alone.step(frame, COMPONENTS), whole.step(frame, COMPONENTS)
        for name in COMPONENTS:
            np.testing.assert_array_equal(ours.extras[name], theirs.extras[name])
        np.testing.assert_allclose(ours.image, theirs.image, rtol=1e-5, atol=1e-6)


def test_a_network_and_a_path_with_a_comma_can_be_parts(tmp_path: Path) -> None:
    run = tmp_path / "a,b"
    network = TinyConfig()
    config = TrainConfig("a,b", data=DataConfig(clips=["."]), network=network, phases=[PhaseConfig(steps=1)])
    run.mkdir()
    (run / "config.yaml").write_text(to_yaml(config))
    write_checkpoint(run, 1, module_state("denoiser.", TinyNetwork(network)))
    frame = floor_frame(0).with_channels(diffuse_albedo=floor_frame(0)["albedo"])
    composite = load_denoiser(LIGHTS.format("svgf", "taa", f"[{run}]"))
    expected = Session(load_denoiser(run)).denoise(frame)
    np.testing.assert_array_equal(Session(composite).step(frame, COMPONENTS).extras["indirect"], expected)
    with pytest.raises(NteError, match=r"a,b' denoises indirect, expected a denoiser of glossy$"):
        load_denoiser(f"composite:visibility=taa,glossy=[{run}],indirect=taa")


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ("composite", "'composite': nothing denoises visibility, glossy, indirect: expected composite:vis"),
        ("composite:visibility=trmv,glossy=trmv", r"nothing denoises indirect: .* \[SPEC\] where SPEC has a comma"),
        ("composite:visibility=trmv,shadows=taa", "'shadows' is no light: expected composite:visibility=SPEC"),
        ("composite:visibility=taa,visibility=svgf", "visibility is given twice"),
        ("composite:visibility=,glossy=taa,indirect=taa", "'visibility=,glossy=taa,indirect=taa' is no light=SPEC"),
        ("composite:visibility=[taa,glossy=taa", "'glossy=taa', '\\[taa'|nothing denoises indirect"),
        ("composite:taa", "'taa' is no light=SPEC"),
        (LIGHTS.format("nosy", "taa", "taa"), "composite, visibility: 'nosy' is no denoiser, did you mean noisy[?]"),
        (LIGHTS.format("[taa:clmp=none]", "taa", "taa"), "composite, visibility: .*'clmp', did you mean clamp[?]"),
        (LIGHTS.format("taa", "taa", "svgf:target=glossy"), "'svgf:target=glossy' denoises glossy, expected .* in"),
        (LIGHTS.format("taa", "taa", "[svgf:target=components]"), "denoises color, expected a denoiser of indirect"),
        (LIGHTS.format("align_accumulate", "taa", "taa"), "align_accumulate: target is 'visibility', expected one of "),
        (LIGHTS.format("taa", "taa", "composite:visibility=taa"), "composite, indirect: .* nothing denoises gl"),
    ],
)  # fmt: skip
def test_a_composite_that_is_none_is_one_line(spec: str, message: str) -> None:
    with pytest.raises(NteError, match=message) as error:
        load_denoiser(spec)
    assert "\n" not in str(error.value)
