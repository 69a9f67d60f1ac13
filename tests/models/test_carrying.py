"""What networks carry follows a change of the exposure, and nothing of it is read where a sequence starts."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from nte.frames.channels import CHANNELS, TEXTURES
from nte.frames.frame import Frame
from nte.models.carrying import Carrying, compressed_moments, scaled
from nte.models.trainable import TrainableDenoiser
from tests.models.lights import NETWORKS, OF_KERNELS, frames_of_all, images, light_network

RADIANCE = [name for name in OF_KERNELS if CHANNELS[NETWORKS[name][1].get("target", "color")].kind == "radiance"]
BRIGHTNESS = st.lists(st.floats(-9, 9).map(lambda stops: 2.0**stops), min_size=3, max_size=3)  # of three frames


def exposed(frames: list[Frame], exposures: list[float]) -> list[Frame]:
    pairs = zip(frames, exposures, strict=True)
    return [replace(frame, exposure=np.array([exposure], np.float32)) for frame, exposure in pairs]


@pytest.mark.parametrize("name", RADIANCE)
@settings(deadline=None, max_examples=15)
@given(BRIGHTNESS)
def test_constant_light_stays_constant_whatever_the_exposure_does(name: str, exposures: list[float]) -> None:
    network, frames = light_network(name), frames_of_all(3)
    colour = np.array([0.75, 0.1, 2.5], np.float32).reshape(1, 3, 1, 1)
    for frame in frames:
        frame[network.target][:] = frame["prior"][:] = colour
        if network.target in TEXTURES:
            frame[TEXTURES[network.target]][:] = np.array([0.5, 0.9, 0.2], np.float32).reshape(1, 3, 1, 1)
    for image in images(network, exposed(frames, exposures)):
        np.testing.assert_allclose(image, np.broadcast_to(colour, image.shape), rtol=2e-4)


@settings(deadline=None, max_examples=15)
@given(BRIGHTNESS)
def test_separate_lights_stay_constant_whatever_the_exposure_does(exposures: list[float]) -> None:
    network, frames = light_network("separated"), frames_of_all(3)
    values = {"visibility": 0.5, "glossy": 0.25, "indirect": 2.0, "diffuse_albedo": 0.5}
    state = None
    for frame in exposed(frames, exposures):
        for name, value in values.items():
            frame[name][:] = value
        result, state = network.step(frame, state, network.components)
        for name in network.components:
            np.testing.assert_allclose(result.extras[name], values[name], rtol=2e-4)


@pytest.mark.parametrize("name", ["color", "glossy", "warped only", "on top", "separated"])
@settings(deadline=None, max_examples=10)
@given(st.floats(-9, 9).map(lambda stops: 2.0**stops))
def test_it_does_not_matter_at_which_exposure_history_was_kept(name: str, change: float) -> None:
    """The same past light, once as frame 0 left it, and once as if frame 0 had had the exposure of frame 1."""
    network, (before, now) = light_network(name), frames_of_all(2)
    before, now = exposed([before, now], [0.5, 0.5 * change])
    _, state = network.step(before, None)
    light = [key for key in state.tensors if "history" in key and "visibility" not in key]
    assert light
    converted = {key: state.tensors[key] * np.float32(change) for key in light}
    converted["previous_exposure"] = torch.tensor([0.5 * change])
    other = state._replace(tensors=state.tensors | converted)
    (image, after), (_, other_after) = network.step(now, state), network.step(now, other)
    for key, values in after.tensors.items():
        torch.testing.assert_close(values, other_after.tensors[key], rtol=1e-4, atol=1e-5)
    forgot = state._replace(tensors=state.tensors | {key: 0 * state.tensors[key] for key in light})
    assert not np.array_equal(image.image, network.step(now, forgot)[0].image)


@pytest.mark.parametrize("name", RADIANCE)
def test_a_constant_exposure_changes_no_bit_of_what_is_carried(name: str) -> None:
    network = light_network(name)
    carried = torch.rand(2, 3, 8, 8)
    given_values = {"exposure": torch.tensor([0.3, 7e-5]), "reset": torch.zeros(2), "history": carried}
    given_values["previous_exposure"] = given_values["exposure"].clone()
    assert torch.equal(Carrying(["history"], {"history": scaled})(given_values), carried)
    frames = frames_of_all(3)
    measured = network.step(frames[0], None)[1].scalars.exposure
    with_given = exposed(frames, 3 * [float(measured[0])])
    for ours, theirs in zip(images(network, frames), images(network, with_given), strict=True):
        assert np.array_equal(ours, theirs)


def test_an_exposure_holds_until_a_frame_gives_another() -> None:
    network, frames = light_network("color"), frames_of_all(4)
    state, known = None, []
    for frame, exposure in zip(frames, (None, 3.0, None, 5.0), strict=True):
        given_frame = frame if exposure is None else replace(frame, exposure=np.array([exposure], np.float32))
        _, state = network.step(given_frame, state)
        known.append(float(state.scalars.exposure[0]))
        assert float(state.tensors["previous_exposure"][0]) == known[-1]
    assert known[0] not in known[1:]
    assert known[1:] == [3.0, 3.0, 5.0]


@pytest.mark.parametrize("change", [1.0, 0.1, 4.0, 300.0])
def test_moments_of_compressed_light_follow_the_exposure(change: float) -> None:
    generator = torch.Generator().manual_seed(0)
    light = torch.tensor([0.01, 0.5, 20.0]).view(1, 1, 1, 3) * (
        1 + 0.02 * torch.randn(4000, 1, 1, 3, generator=generator)
    )

    def moments(exposed_light: torch.Tensor) -> torch.Tensor:
        y = torch.log1p(exposed_light.double())
        return torch.cat([y.mean(0, keepdim=True), y.square().mean(0, keepdim=True)], 1)

    found = compressed_moments(moments(light), torch.full((1, 1, 1, 1), change, dtype=torch.float64))
    expected = moments(light * change)
    deviations = [(m[:, 1] - m[:, 0].square()).sqrt() for m in (found, expected)]
    torch.testing.assert_close(found[:, 0], expected[:, 0], rtol=1e-3, atol=1e-6)
    torch.testing.assert_close(*deviations, rtol=2e-2, atol=1e-6)


def inputs_at_a_reset(network: TrainableDenoiser, frame: Frame, carried: float) -> list[torch.Tensor]:
    """The inputs of `forward` for a batch of one that starts, with one value in all that the past would give."""
    made = {name: torch.as_tensor(frame[name]) for name in (*network.needs, *network.optional) if name in frame}
    made |= {name: torch.ones(1) for name in ("reset", "exposure", "depth_scale")}
    size = frame.size
    made |= {name: torch.full(tensor.shape(1, *size), carried) for name, tensor in network.recurrent.items()}
    made["previous_forward_motion"] = torch.full((1, 2, *size), carried)
    return [made[name] for name in network.inputs]


@pytest.mark.parametrize("name", NETWORKS)
def test_at_a_reset_the_past_may_be_anything(name: str) -> None:
    network, (frame,) = light_network(name), frames_of_all(1)
    expected = network(*inputs_at_a_reset(network, frame, 0.0))
    for carried in (float("nan"), float("inf"), -1e30, 3.0):
        for output, ours, theirs in zip(
            network.outputs, network(*inputs_at_a_reset(network, frame, carried)), expected, strict=True
        ):
            assert torch.equal(ours, theirs), (output, carried)
