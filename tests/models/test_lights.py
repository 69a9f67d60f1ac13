"""Every kind of network denoises every kind of light: units, borders, resets, bad pixels, gradients, export."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from nte.errors import NteError
from nte.frames.channels import CHANNELS, COMPONENTS, TEXTURES, Channel, width_of
from nte.frames.frame import Frame
from nte.models.rae import RaeConfig
from nte.models.reading import feature
from nte.models.registry import make_network
from nte.models.reprojection import LONGEST, accumulate
from nte.models.temporal import TemporalConfig
from nte.runtime.export import export_onnx
from nte.runtime.session import OnnxDenoiser
from nte.runtime.trial import difference
from tests.models.lights import NETWORKS, OF_KERNELS, frames_of_all, images, light_network

EXTREMES = [np.nan, np.inf, -np.inf, -1.0, 1e-30, 6e4, 3e38]


@pytest.mark.parametrize("name", NETWORKS)
def test_images_have_the_frames_size_and_the_range_of_the_light(name: str) -> None:
    network = light_network(name)
    for image in images(network, frames_of_all(3, (17, 31))):
        assert image.shape == (1, width_of(network.target), 17, 31)
        assert np.isfinite(image).all()
        assert (image >= 0).all()
        assert CHANNELS[network.target].kind == "radiance" or (image <= 1).all()


@pytest.mark.parametrize("name", NETWORKS)
def test_a_sequence_that_starts_anew_knows_nothing_of_the_one_before(name: str) -> None:
    network, one = light_network(name), np.ones(1, np.float32)  # scalars of the sequence count as remembered, too
    frames = [replace(frame, exposure=one, depth_scale=one) for frame in frames_of_all(4)]
    anew = [*frames[:2], replace(frames[2], reset=one), frames[3]]
    resumed, fresh, through = (images(network, sequence) for sequence in (anew, frames[2:], frames))
    for ours, theirs in zip(resumed[2:], fresh, strict=True):
        np.testing.assert_array_equal(ours, theirs)
    remembers = [recurrent for recurrent in network.recurrent if recurrent != "previous_depth"]
    assert np.array_equal(through[3], fresh[1]) == (not remembers)


@pytest.mark.parametrize("name", NETWORKS)
def test_gradients_reach_every_weight(name: str) -> None:
    network = light_network(name).requires_grad_(True)
    state, total = None, torch.zeros(())
    for frame in frames_of_all(3):
        result, state = network.step(frame.torch(), state)
        total = total + result.image.square().sum()
    total.backward()
    for parameter_name, parameter in network.named_parameters():
        assert parameter.grad is not None, parameter_name
        assert parameter.grad.isfinite().all(), parameter_name
        assert parameter.grad.any(), parameter_name


@pytest.mark.parametrize("name", ["color", "indirect", "glossy", "rae", "separated"])
def test_light_of_another_unit_gives_the_same_image_in_that_unit(name: str) -> None:
    network, frames = light_network(name), frames_of_all(2)
    lights = [name for name, row in CHANNELS.items() if row.kind == "radiance" or row.unit == "luminance"]
    for factor in (1e-6, 1e4):
        scaled = [f.with_channels(**{n: f[n] * np.float32(factor) for n in lights if n in f}) for f in frames]
        for image, other in zip(images(network, frames), images(network, scaled), strict=True):
            np.testing.assert_allclose(other / factor, image, rtol=1e-3, atol=1e-4)


def test_an_image_that_was_predicted_black_can_still_learn() -> None:
    network = light_network("rae").requires_grad_(True)
    last = network.decoder.last
    assert last.bias is not None
    with torch.no_grad():
        last.weight *= 0.1
        last.bias[:] = -20.0
    result, _ = network.step(frames_of_all(1)[0].torch(), None)
    assert not result.image.any()
    result.image.mean().backward()
    assert last.bias.grad is not None
    assert (last.bias.grad > 0.1).all()


@pytest.mark.parametrize("name", OF_KERNELS)
def test_kernels_keep_a_constant(name: str) -> None:
    network, frames = light_network(name), frames_of_all(3)
    for frame in frames:
        frame[network.target][:] = 0.75
        if network.target in TEXTURES:
            frame[TEXTURES[network.target]][:] = 0.5
        frame["prior"][:] = 0.75
    for image in images(network, frames):
        np.testing.assert_allclose(image, 0.75, rtol=1e-4)


@pytest.mark.parametrize("name", NETWORKS)
def test_bad_pixels_in_any_channel_leave_a_usable_image(name: str) -> None:
    network = light_network(name)
    for channel in (*network.needs, *network.optional):
        frames = frames_of_all(2)
        for frame in frames:
            values = frame[channel].copy().reshape(-1)
            values[:: 1 + len(values) // 60] = np.resize(EXTREMES, len(values[:: 1 + len(values) // 60]))
            frame.channels[channel] = values.reshape(frame[channel].shape)
        for image in images(network, frames):
            assert np.isfinite(image).all(), channel
            assert (image >= 0).all(), channel


@pytest.mark.parametrize("name", NETWORKS)
def test_every_channel_that_is_taken_matters(name: str) -> None:
    network, frames = light_network(name), frames_of_all(2)
    expected = images(network, frames)[-1]
    rng = np.random.default_rng(1)
    for channel in set(network.needs) - {"motion"}:
        changed = [
            f.with_channels(**{channel: f[channel] * rng.uniform(0.3, 1, (24, 36)).astype(np.float32)}) for f in frames
        ]
        assert not np.array_equal(images(network, changed)[-1], expected), channel


def without(frame: Frame, *names: str) -> Frame:
    return replace(frame, channels={name: v for name, v in frame.channels.items() if name not in names})


def test_the_exposure_of_light_is_given_or_measured_from_color() -> None:
    (frame,) = frames_of_all(1)
    for name in ("indirect", "rae"):
        network = light_network(name)
        assert "color" not in network.inputs
        assert "color" in network.optional
        with pytest.raises(NteError, match=r"frame 0: no exposure, and no channel 'color' to measure it from; it has "):
            network.step(without(frame, "color"), None)
        given = replace(without(frame, "color"), exposure=np.ones(1, np.float32))
        assert np.isfinite(network.step(given, None)[0].image).all()
    alone = light_network("share alone")  # sees no light at all
    assert "exposure" not in alone.inputs
    assert alone.optional == ("previous_forward_motion",)
    np.testing.assert_array_equal(*images(alone, [frame]), *images(alone, [without(frame, "color")]))


@pytest.mark.parametrize("row", CHANNELS.values(), ids=lambda row: row.name)
def test_features_are_finite_and_of_a_scale_of_one(row: Channel) -> None:
    extremes = torch.tensor([0.0, 1.0, *EXTREMES]).view(1, 1, 1, -1).expand(1, len(row.components), 3, -1)
    made = feature(row.name, extremes, torch.tensor([0.5]), torch.tensor([2.0]))
    assert made.shape == extremes.shape
    assert made.isfinite().all()
    assert row.kind == "id" or made.abs().max() < 100


def test_statistics_are_means_over_the_frames_in_which_a_surface_was_seen() -> None:
    values = torch.rand(5, 1, 1, 2, 3)
    moments, length = torch.zeros(1, 2, 2, 3), torch.zeros(1, 1, 2, 3)
    for index, value in enumerate(values):
        valid = torch.full((1, 1, 2, 3), index > 0)
        valid[..., 0, 0] = index > 3  # seen in the last two frames alone
        found = accumulate(value, moments.nan_to_num() if index else moments / 0, length, valid)
        moments, length = found
    assert length[0, 0, 1, 1] == 5
    assert length[0, 0, 0, 0] == 2
    torch.testing.assert_close(moments[0, 0, 1], values.mean(0)[0, 0, 1])
    torch.testing.assert_close(found.deviation()[0, 0, 1], values.std(0, correction=0)[0, 0, 1], rtol=1e-3, atol=1e-4)
    torch.testing.assert_close(
        found.deviation()[..., 0, 0], values[3:, ..., 0, 0].std(0, correction=0), rtol=1e-3, atol=1e-4
    )
    everywhere = torch.ones(1, 1, 2, 3, dtype=torch.bool)
    assert accumulate(values[0], moments, torch.full_like(length, LONGEST), everywhere).length.max() == LONGEST


@pytest.mark.parametrize(
    ("config", "message"),
    [
        (TemporalConfig(target="albedo"), "network.target is 'albedo', expected one of color, visibility, glossy, ind"),
        (TemporalConfig(target="glossy", demodulate=True), "network.demodulate is true, but 'glossy' has no texture"),
        (TemporalConfig(inputs=["albedo"]), "network.inputs has 'albedo', which the network sees already"),
        (RaeConfig(inputs=["direct", "direct"]), "network.inputs has 'direct', which the network sees already"),
        (RaeConfig(inputs=["reference_glossy"]), "network.inputs has 'reference_glossy'.* expected one of .*roughness"),
        (TemporalConfig(inputs=["forward_motion"]), "network.inputs has 'forward_motion'.* expected one of "),
        (TemporalConfig(inputs=["instance"]), "network.inputs has 'instance'.* expected one of "),
        (TemporalConfig(finest="none"), "network.finest is 'none', expected kernels or mixing"),
        (
            TemporalConfig(finest="mixing"),
            "network.front is 1 and network.scales is 3, expected a front of 2 and",
        ),
        (
            TemporalConfig(finest="mixing", front=2, scales=1),
            "network.scales is 1, expected a front of 2 and at",
        ),
        (
            TemporalConfig(finest="mixing", front=2, temporal=False),
            "network.finest is mixing, which has a weight for",
        ),
        (
            TemporalConfig(prior="oidn"),
            "network.finest is kernels and network.target is color, expected mixing and a radiance, as network.prior",
        ),
        (TemporalConfig(feature_history=-1), "network.feature_history is -1, expected a number of features from 0"),
        (RaeConfig(channels=[]), r"network.channels is \[\], expected at least one width"),
    ],
)
def test_settings_that_make_no_network(config: TemporalConfig, message: str) -> None:
    with pytest.raises(NteError, match=message):
        make_network(config)


@pytest.mark.slow
@pytest.mark.parametrize("name", NETWORKS)
def test_the_exported_graph_is_the_network(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    network = light_network(name)
    monkeypatch.setattr("nte.runtime.export.CHECK_FRAMES", 3)  # at each of three sizes
    export_onnx(network, tmp_path / "model.onnx", progress=lambda line: None)
    exported = OnnxDenoiser(tmp_path / "model.onnx")
    assert (exported.target, exported.needs) == (network.target, network.needs)
    assert set(exported.optional) == set(network.optional)
    parameters = sum(parameter.numel() for parameter in network.parameters())
    assert exported.info["cost"][0].startswith(f"{parameters:,} parameters, ")
    assert exported.components == network.components
    result, _ = exported.step(frames_of_all(1)[0], None, exported.extras)
    assert list(result.extras) == list(exported.extras)
    assert set(exported.extras) <= set(network.extras)
    frames = frames_of_all(3, (19, 34))
    frames[2] = replace(frames[2], reset=np.ones(1, np.float32))
    for ours, theirs in zip(images(exported, frames), images(network, frames), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-3, atol=1e-4)
    typical, _ = difference(exported, light_network(name, seed=1), (33, 47))
    assert typical > 1e-3  # other weights are another image: the comparison sees them


def test_a_network_that_cannot_measure_its_exposure_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("nte.models.reading.Reader.measured", ())
    with pytest.raises(NteError, match=r"takes 'exposure', which is measured from color .*: expected color in opt"):
        light_network("indirect")


def test_separate_lights_are_composed_to_the_image() -> None:
    network, frames = light_network("separated"), frames_of_all(3)
    state = None
    for frame in frames:
        result, state = network.step(frame, state, COMPONENTS)
        visibility, glossy, indirect = (result.extras[name] for name in COMPONENTS)
        assert visibility.shape == (1, 1, 24, 36)
        composed = frame["emission"] + frame["direct"] * visibility + glossy + indirect
        np.testing.assert_allclose(result.image, composed, rtol=1e-5)
    for name in COMPONENTS:  # each light has kernels and a history of its own
        other = frames[2].with_channels(**{name: 0 * frames[2][name]})
        network_state = network.step(frames[1], network.step(frames[0], None)[1])[1]
        for image, light in zip((other, frames[2]), ("black", "as it is"), strict=True):
            extras = network.step(image, network_state, COMPONENTS)[0].extras
            assert (extras[name].mean() < result.extras[name].mean()) == (light == "black")
    black = {f"{name}_history": 0 * state.tensors[f"{name}_history"] for name in COMPONENTS}
    forgot = state._replace(tensors=state.tensors | black)
    assert not np.array_equal(network.step(frames[0], state)[0].image, network.step(frames[0], forgot)[0].image)


def test_separate_lights_keep_constants() -> None:
    network, frames = light_network("separated"), frames_of_all(3)
    values = {"visibility": 0.5, "glossy": 0.25, "indirect": 2.0, "diffuse_albedo": 0.5}
    for frame in frames:
        for name, value in values.items():
            frame[name][:] = value
    state = None
    for frame in frames:
        result, state = network.step(frame, state, COMPONENTS)
        for name in COMPONENTS:
            np.testing.assert_allclose(result.extras[name], values[name], rtol=1e-4)
