"""An exported model is the PyTorch denoiser once more, and says by name what does not fit."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import onnx
import pytest
import torch

from nte.denoiser import Denoiser, Session
from nte.errors import NteError
from nte.frames.frame import Frame
from nte.models.temporal import TemporalDenoiser
from nte.registry import load_denoiser
from nte.runtime.description import UNSEALED, seal
from nte.runtime.providers import OnnxOptions
from nte.runtime.session import OnnxDenoiser
from nte.runtime.weights import require_finite_weights
from tests.synthetic import random_channels, random_frames


@pytest.fixture(scope="module")
def exported(model: Path) -> OnnxDenoiser:
    return OnnxDenoiser(model, OnnxOptions(threads=1))


def both(network: TemporalDenoiser, exported: OnnxDenoiser, frames: list[Frame]) -> list[tuple[np.ndarray, np.ndarray]]:
    """(PyTorch's image, ONNX Runtime's) of every frame, each with a state of its own."""
    sessions = Session(network), Session(exported)
    return [(sessions[0].denoise(frame), sessions[1].denoise(frame)) for frame in frames]


def assert_close(pairs: list[tuple[np.ndarray, np.ndarray]]) -> None:
    for ours, theirs in pairs:
        np.testing.assert_allclose(theirs, ours, rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize(("size", "batch"), [((16, 16), 1), ((17, 31), 3), ((45, 22), 2)])
def test_equals_pytorch_at_any_size_and_batch(
    network: TemporalDenoiser, exported: OnnxDenoiser, size: tuple[int, int], batch: int
) -> None:
    assert_close(both(network, exported, random_frames(4, size, batch)))


def test_equals_pytorch_with_scattered_forward_motion(network: TemporalDenoiser, exported: OnnxDenoiser) -> None:
    frames = random_frames(4, batch=2)
    without = [Frame({k: v for k, v in f.channels.items() if k != "previous_forward_motion"}) for f in frames]
    pairs = both(network, exported, without)
    assert_close(pairs)
    assert not np.allclose(pairs[-1][0], both(network, exported, frames)[-1][0])
    # A sequence of a batch that gives NaN everywhere gets the same, beside one that knows its vectors.
    for frame in frames:
        frame["previous_forward_motion"][1] = np.nan
    beside = both(network, exported, frames)
    assert_close(beside)
    for mixed, alone in zip(beside, pairs, strict=True):
        np.testing.assert_array_equal(mixed[1][1], alone[1][1])
    assert not np.array_equal(beside[-1][1][0], pairs[-1][1][0])


def test_equals_pytorch_where_history_comes_from_outside(network: TemporalDenoiser, exported: OnnxDenoiser) -> None:
    # A slanted edge between what comes from outside the image and what stands still, and an image all from outside.
    frames = random_frames(4, batch=2)
    y, x = np.indices((24, 36))
    for frame in frames[1:]:
        frame["motion"][:] = np.where(x + 2 * y < 40, 1e4, 0.25)
    frames[3]["motion"][1] = -1e4
    states = [None, None]
    for frame in frames:
        results = []
        for i, denoiser in enumerate((network, exported)):
            result, states[i] = denoiser.step(frame, states[i], ("alpha", "valid"))
            results.append(result)
        assert_close([(results[0].image, results[1].image), (results[0].extras["alpha"], results[1].extras["alpha"])])
        assert np.array_equal(results[0].extras["valid"], results[1].extras["valid"])
    assert (results[1].extras["alpha"][1] == 1).all()
    assert 0.2 < (results[1].extras["alpha"][0] == 1).mean() < 0.8


def test_equals_pytorch_with_given_scalars_and_after_a_reset(network: TemporalDenoiser, exported: OnnxDenoiser) -> None:
    frames = random_frames(4, batch=2)
    scalars = {"exposure": np.array([2, 0.5], np.float32), "depth_scale": np.array([3, 9], np.float32)}
    assert_close(both(network, exported, [replace(frame, **scalars) for frame in frames]))
    frames[2]["color"][1] *= 10
    frames[2] = replace(frames[2], reset=np.array([0, 1], np.float32))
    assert_close(both(network, exported, frames))


def test_a_reset_is_a_new_start_for_that_sequence_alone(exported: OnnxDenoiser) -> None:
    frames = random_frames(4, batch=2)
    for frame in frames[2:]:
        frame["color"][1] *= 10
    reset = replace(frames[2], reset=np.array([0, 1], np.float32))

    def images(sequence: list[Frame]) -> list[np.ndarray]:
        running = Session(exported)
        return [running.denoise(frame) for frame in sequence]

    resumed, fresh, through = images([*frames[:2], reset, frames[3]])[2:], images(frames[2:]), images(frames)[2:]
    for image, new, old in zip(resumed, fresh, through, strict=True):
        np.testing.assert_array_equal(image[1], new[1])
        np.testing.assert_array_equal(image[0], old[0])


def test_it_is_a_denoiser_that_returns_what_it_was_given(network: TemporalDenoiser, exported: OnnxDenoiser) -> None:
    assert isinstance(exported, Denoiser)
    assert (exported.needs, exported.optional, exported.target) == (network.needs, network.optional, network.target)
    (frame,) = random_frames(1)
    result, _ = exported.step(frame.torch(), None, ("alpha", "valid"))
    assert isinstance(result.image, torch.Tensor)
    assert isinstance(result.extras["alpha"], torch.Tensor)
    plain, _ = exported.step(frame, None)
    np.testing.assert_array_equal(result.image.numpy(), plain.image)


def test_the_given_state_can_be_used_again(exported: OnnxDenoiser) -> None:
    first, second, other = random_frames(3)
    _, state = exported.step(first, None)
    once, _ = exported.step(second, state)
    exported.step(other, state)
    again, _ = exported.step(second, state)
    np.testing.assert_array_equal(once.image, again.image)


def test_every_number_of_threads_gives_the_same(model: Path) -> None:
    (frame,) = random_frames(1, size=(64, 64))
    images = [Session(OnnxDenoiser(model, OnnxOptions(threads=n))).denoise(frame) for n in (1, None)]
    np.testing.assert_allclose(images[0], images[1], rtol=1e-4, atol=1e-5)


def without(name: str) -> Callable[[dict[str, np.ndarray]], object]:
    return lambda channels: channels.pop(name)


def changed(name: str, change: Callable[[np.ndarray], np.ndarray]) -> Callable[[dict[str, np.ndarray]], object]:
    return lambda channels: channels.update({name: change(channels[name])})


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (without("albedo"), "channel 'albedo' is missing; it has color"),
        (changed("depth", lambda a: a.astype(np.float64)), "channel 'depth' is float64, expected float32"),
        (changed("color", lambda a: a.astype(np.float16)), "channel 'color' is float16, expected float32"),
        (changed("normal", lambda a: a[:, :2]), r"'normal' is \(1, 2, 24, 36\), expected \(N, 3, H, W\)"),
        (
            changed("previous_forward_motion", lambda a: a.astype(np.float64)),
            "'previous_forward_motion' is float64, expected float32",
        ),
        (changed("previous_forward_motion", lambda a: a[:, :1]), r"'previous_forward_motion' is \(1, 1, 24, 36\)"),
    ],
)
def test_a_channel_that_does_not_fit_is_named(
    exported: OnnxDenoiser, change: Callable[[dict[str, np.ndarray]], object], message: str
) -> None:
    channels = random_channels(np.random.default_rng(0))
    change(channels)
    with pytest.raises(NteError, match=r"frame 7: .*" + message):
        exported.step(Frame(channels, 7), None)


def test_a_size_that_does_not_fit(exported: OnnxDenoiser) -> None:
    _, state = exported.step(random_frames(1)[0], None)
    for size, batch in (((24, 40), 1), ((24, 36), 2)):
        with pytest.raises(NteError, match=r"is \(\d, 24, \d+\) after \(1, 24, 36\): start a new sequence"):
            exported.step(random_frames(1, size, batch)[0], state)
    with pytest.raises(NteError, match=r"size \(15, 40\), expected at least 16"):
        exported.step(random_frames(1, (15, 40))[0], None)


def test_scalars_extras_and_providers_that_are_wrong(exported: OnnxDenoiser, model: Path) -> None:
    (frame,) = random_frames(1)
    for exposure in ([0.0], [-1.0], [np.nan], [1.0, 2.0]):
        with pytest.raises(NteError, match=r"frame 0: exposure is .*expected a positive number"):
            exported.step(replace(frame, exposure=np.array(exposure, np.float32)), None)
    with pytest.raises(NteError, match="OnnxDenoiser has no extra 'kernels'; it has disoccluded, valid, alpha"):
        exported.step(frame, None, ("kernels",))
    with pytest.raises(NteError, match=r"--device abacus:0: no exported model runs there: expected one of cpu, "):
        load_denoiser(str(model), device="abacus:0")
    assert isinstance(load_denoiser(str(model)), OnnxDenoiser)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("target", "nope"), ("target", None), ("target", ["color"]), ("needs", "color"), ("needs", [1]),
        ("needs", ["colour"]), ("optional", None), ("smallest", "16"), ("smallest", -1), ("smallest", True),
        ("state", {}), ("state", []), ("state", {"history": "nowhere"}), ("state", {"history": 3}),
        ("state", {"history": "image", "more": "image"}), ("version", 1), ("conventions", []), ("sha256", None),
    ],
)  # fmt: skip
def test_a_description_that_cannot_be_is_refused(model: Path, tmp_path: Path, key: str, value: object) -> None:
    said = onnx.load(model)
    described = json.loads({p.key: p.value for p in said.metadata_props}["nte"])
    onnx.helper.set_model_props(said, {"nte": json.dumps(described | {"sha256": UNSEALED, key: value})})
    onnx.save(said, tmp_path / "said.onnx")
    seal(tmp_path / "said.onnx")
    with pytest.raises(NteError, match=rf"said\.onnx: '{key}' in the model's metadata is ") as error:
        OnnxDenoiser(tmp_path / "said.onnx")
    assert "\n" not in str(error.value)


def of_nan(weights: np.ndarray) -> np.ndarray:
    weights = weights.copy()
    weights[-1, 0] = np.nan
    return weights


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (of_nan, "the weights 'prediction.trunk.unet.encoders.1.0.weight' are not finite"),
        (lambda weights: weights * np.float32(np.inf), "the weights '.*' are not finite"),
        (lambda weights: weights.astype(np.int32), "not a readable ONNX model"),
        (lambda weights: weights.view(np.int32), "not a readable ONNX model"),
        (lambda weights: weights.astype(np.float64), "not a readable ONNX model"),
    ],
    ids=["NaN", "Inf", "int32", "bits of int32", "float64"],
)
@pytest.mark.parametrize("sealed", [True, False], ids=["sealed anew", "old checksum"])
def test_weights_that_cannot_be_are_refused(
    model: Path, tmp_path: Path, change: Callable[[np.ndarray], np.ndarray], message: str, sealed: bool
) -> None:
    spoilt = onnx.load(model)
    (weights,) = [tensor for tensor in spoilt.graph.initializer if tensor.name.endswith("encoders.1.0.weight")]
    weights.CopyFrom(onnx.numpy_helper.from_array(change(onnx.numpy_helper.to_array(weights)), weights.name))
    if sealed:
        described = json.loads({p.key: p.value for p in spoilt.metadata_props}["nte"])
        onnx.helper.set_model_props(spoilt, {"nte": json.dumps(described | {"sha256": UNSEALED})})
    path = tmp_path / "spoilt.onnx"
    onnx.save(spoilt, path)
    if sealed:
        seal(path)
    with pytest.raises(NteError, match=rf"spoilt\.onnx: {message if sealed else 'damaged: its checksum'}") as error:
        OnnxDenoiser(path)
    assert "\n" not in str(error.value)


def test_weights_that_are_listed_one_by_one_are_looked_at_too(model: Path, tmp_path: Path) -> None:
    listed, path = onnx.load(model), tmp_path / "listed.onnx"
    for tensor in listed.graph.initializer:
        values = onnx.numpy_helper.to_array(tensor)
        tensor.CopyFrom(onnx.helper.make_tensor(tensor.name, tensor.data_type, tensor.dims, values.ravel()))
    onnx.save(listed, path)
    require_finite_weights(path)
    listed.graph.initializer[0].float_data[3] = np.nan
    onnx.save(listed, path)
    with pytest.raises(NteError, match=r"listed\.onnx: the weights 'prediction\..*' are not finite"):
        require_finite_weights(path)


def test_files_that_are_no_model_of_ours(model: Path, tmp_path: Path) -> None:
    foreign = onnx.load(model)
    for metadata in ({}, {"nte": "not JSON"}, {"nte": "[1]"}, {"nte": json.dumps({"format": "nte-onnx/9\n\x1b"})}):
        onnx.helper.set_model_props(foreign, metadata)
        onnx.save(foreign, tmp_path / "foreign.onnx")
        with pytest.raises(NteError, match=r"foreign\.onnx: .* in the model's metadata, expected 'nte-onnx/2'") as said:
            OnnxDenoiser(tmp_path / "foreign.onnx")
        assert str(said.value).isprintable()
    whole = model.read_bytes()
    flipped = bytearray(whole)
    flipped[len(whole) // 2] ^= 1  # in the weights: a model that runs, and denoises otherwise
    for content in (b"", b"no model", whole[:-500], whole[:-100], bytes(flipped)):
        (tmp_path / "damaged.onnx").write_bytes(content)
        with pytest.raises(NteError, match=r"damaged\.onnx: (not a readable ONNX model|damaged: its check)") as error:
            OnnxDenoiser(tmp_path / "damaged.onnx")
        assert "\n" not in str(error.value)
    with pytest.raises(NteError, match=r"nowhere\.onnx: does not exist"):
        OnnxDenoiser(tmp_path / "nowhere.onnx")
    with pytest.raises(NteError, match=r"does not exist; expected an .onnx file"):
        OnnxDenoiser(tmp_path)
