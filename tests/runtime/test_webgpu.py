"""WebGPU computes what the CPU does, and the state stays in its memory. Skipped without its package or a device.

A processor passes for a device where the environment has ORT_WEBGPU_EP_ALLOW_SOFTWARE_ADAPTER=1, VK_ICD_FILENAMES names
the driver of SwiftShader, and LD_LIBRARY_PATH the folder of libvulkan.so.1; Chromium brings both.
"""

import sys
from pathlib import Path

import numpy as np
import pytest

from nte.errors import NteError
from nte.runtime.placement import placement
from nte.runtime.providers import OnnxOptions, devices_of, installed
from nte.runtime.session import OnnxDenoiser
from nte.runtime.trial import trial_frames
from tests.synthetic import random_frames

there = pytest.mark.skipif("webgpu" not in installed(), reason="WebGPU is not installed, or finds no device")


@there
@pytest.mark.slow
def test_it_agrees_with_the_cpu_and_keeps_the_state(model: Path) -> None:
    plain, fast, state, other, errors = OnnxDenoiser(model), OnnxDenoiser(model, OnnxOptions("webgpu")), None, None, []
    for frame in trial_frames((*plain.needs, *plain.optional), (24, 36), 4, batch=1):
        theirs, other = plain.step(frame, other)
        ours, state = fast.step(frame, state)
        errors.append(np.abs(ours.image - theirs.image) / (np.abs(theirs.image) + 0.01))
        assert {value.device_name() for value in state.tensors.values()} == {"webgpu"}
    assert np.quantile(errors, 0.999) < 1e-3


@there
def test_it_refuses_few_operators(model: Path) -> None:
    found = placement(model, "webgpu")
    assert found
    assert found.asked
    assert not {"Conv", "If", "Where"} & {*found.refused}


def test_it_stands_beside_onnxruntime(model: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("nte.runtime.providers.find_spec", lambda name: None)
    with pytest.raises(NteError, match=r"webgpu is not installed; .*onnxruntime-ep-webgpu: pip install onnxruntime-ep"):
        OnnxDenoiser(model, OnnxOptions("webgpu"))


def test_a_machine_without_a_device_is_one_line(model: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("nte.runtime.providers.find_spec", lambda name: object())
    monkeypatch.setattr("nte.runtime.providers.devices_of", lambda provider: [])
    with pytest.raises(NteError, match=r"onnxruntime-ep-webgpu is installed, but finds no device; on Linux"):
        OnnxDenoiser(model, OnnxOptions("webgpu"))


def test_a_library_that_does_not_fit_is_one_line(model: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """ONNX Runtime is given a file that is no library; the CPU goes on without it."""
    (tmp_path / "broken.so").write_text("no library")
    (tmp_path / "onnxruntime_ep_webgpu.py").write_text(
        f"def get_library_path():\n    return {str(tmp_path / 'broken.so')!r}\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "onnxruntime_ep_webgpu", raising=False)
    devices_of.cache_clear()
    with pytest.raises(NteError, match=r"onnxruntime-ep-webgpu is installed, but cannot be loaded: ") as error:
        OnnxDenoiser(model, OnnxOptions("webgpu"))
    assert "\n" not in str(error.value)
    assert "webgpu" not in installed()
    OnnxDenoiser(model).step(random_frames(1)[0], None)
    devices_of.cache_clear()
