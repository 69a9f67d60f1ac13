"""An exported model as a denoiser: what it takes and returns, and what it says by name of a frame that does not fit."""

import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from onnxruntime import OrtValue

from nte.denoiser import Denoiser
from nte.errors import NteError
from nte.frames.frame import Frame
from nte.models.temporal import TemporalDenoiser
from nte.registry import load_denoiser
from nte.released import model_path
from nte.runtime.providers import OnnxOptions
from nte.runtime.session import OnnxDenoiser
from nte.session import Session
from tests.synthetic import random_channels, random_frames


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


def test_the_released_model_starts_within_a_second() -> None:
    """Of the processor's time, as other programs may run beside it."""
    taken = []
    for _ in range(3):
        begin = time.process_time()
        OnnxDenoiser(str(model_path("steady")), OnnxOptions(threads=1))
        taken.append(time.process_time() - begin)
    assert min(taken) < 1


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
    with pytest.raises(NteError, match="model has no extra 'kernels', expected one of disoccluded, valid"):
        exported.step(frame, None, ("kernels",))
    with pytest.raises(NteError, match=r"--device abacus:0: no exported model runs there: expected one of cpu, "):
        load_denoiser(str(model), device="abacus:0")
    assert isinstance(load_denoiser(str(model)), OnnxDenoiser)


def test_nothing_is_printed_beside_the_error(exported: OnnxDenoiser, capfd: pytest.CaptureFixture[str]) -> None:
    first, second = random_frames(2)
    _, state = exported.step(first, None)
    few = OrtValue.ortvalue_from_numpy(np.zeros((1, 1, 5, 5), np.float32))  # an operator finds that it does not fit
    with pytest.raises(NteError, match=r"model\.onnx: cannot run this frame: "):
        exported.step(second, state._replace(tensors=state.tensors | {"previous_depth": few}))
    assert capfd.readouterr() == ("", "")


@pytest.mark.slow
def test_later_frames_need_little_more_memory_than_the_first(model: Path) -> None:
    """In a process of its own; a shell starts it, as Linux counts the memory of who starts one, too."""
    program = """
import sys
from nte.evaluation.benchmark.frames import synthetic_frames
from nte.memory import peak_resident_mb
from nte.runtime.session import OnnxDenoiser
denoiser, state = OnnxDenoiser(sys.argv[1]), None
frame = synthetic_frames((360, 640), [*denoiser.needs, *denoiser.optional])(0)
before = peak_resident_mb()
for _ in range(5):
    _, state = denoiser.step(frame, state)
    print(peak_resident_mb() - before)
"""
    by_a_shell = ["sh", "-c", '"$0" -c "$1" "$2"; exit $?', sys.executable, program, str(model)]
    said = subprocess.run(by_a_shell, capture_output=True, text=True, check=True).stdout
    peaks = [float(line) for line in said.split()]
    assert peaks[0] > 20
    assert peaks[-1] < 1.3 * peaks[0]
