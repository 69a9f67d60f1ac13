"""An exported model is the PyTorch denoiser once more: at any size, with whatever a frame has, over many frames."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from nte.frames.frame import Frame
from nte.models.temporal import TemporalDenoiser
from nte.runtime.export import export_onnx
from nte.runtime.providers import OnnxOptions, installed
from nte.runtime.session import OnnxDenoiser
from nte.runtime.trial import Numbers, trial_frames
from nte.session import Session
from tests.conftest import Rounds
from tests.networks import small_network
from tests.runtime.conftest import CHOICES
from tests.synthetic import random_frames


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


@pytest.mark.slow
@pytest.mark.parametrize(
    "more",
    [{}, {"finest": "mixing", "prior": "oidn:quality=fast", "moments": True, "feature_history": 2}],
    ids=["kernels", "on top of another"],
)
def test_many_frames_do_not_drift_apart(more: dict[str, object], tmp_path: Path, rounds: Rounds) -> None:
    """Nothing adds up in what is carried: the last frames are as close as all of them.

    Exposures change all the time, and now and then one of two sequences begins anew.
    """
    network, model = small_network(**CHOICES | more), tmp_path / "model.onnx"
    export_onnx(network, model, progress=lambda line: None)
    count = rounds("frames in several engines", 1000, 10_000)
    engines = [name for name in ("cpu", "openvino") if name in installed()]
    exported = {name: Session(OnnxDenoiser(model, OnnxOptions(provider=name, threads=1))) for name in engines}
    ours, errors = Session(network), {name: list[Numbers]() for name in engines}
    with torch.no_grad():
        for frame in trial_frames((*network.needs, *network.optional), (17, 23), count, batch=2):
            if frame.index % 40 == 39:
                frame = replace(frame, reset=np.array([0, 1], np.float32))
            expected = ours.denoise(frame)
            for name, session in exported.items():
                errors[name].append(np.abs(session.denoise(frame) - expected) / (np.abs(expected) + 0.01))
    for name, found in errors.items():
        assert np.quantile(found, 0.999) < 1e-3, name
        assert np.quantile(found[-count // 10 :], 0.999) < 1e-3, name
