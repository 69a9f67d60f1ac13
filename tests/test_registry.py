"""What a user types becomes a denoiser, or one line that says what there is."""

from pathlib import Path
from typing import Any

import onnxruntime
import pytest
import torch

from nte.denoiser import Denoiser, Noisy
from nte.errors import NteError
from nte.filters.taa import Taa
from nte.registry import NAMES, load_denoiser


@pytest.mark.parametrize("name", [name for name in NAMES if name != "oidn"])
def test_every_name_is_a_denoiser(name: str) -> None:
    assert isinstance(load_denoiser(name), Denoiser)


def test_options_become_the_types_of_their_defaults() -> None:
    taa = load_denoiser("taa: clamp=clip , alpha=0.25")
    assert isinstance(taa, Taa)
    assert (taa.clamp, taa.alpha) == ("clip", 0.25)
    assert isinstance(load_denoiser("noisy:"), Noisy)


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ("nosy", "'nosy' is no denoiser: expected a run folder, an .onnx file, or one of noisy, taa"),
        ("", "'' is no run folder"),
        ("taa:clmp=none", "'taa:clmp=none': unknown option 'clmp'; it has clamp, alpha"),
        ("taa:clamp", "'clamp' is no option: expected name:key=value"),
        ("taa:clamp=", "'clamp' is no option"),
        ("taa:alpha=much", "alpha is 'much', expected float"),
        ("taa:alpha=2", "taa: alpha is 2.0"),
        ("taa:clamp=hard", "taa: clamp is 'hard'"),
        ("taa:device=cpu", "unknown option 'device'; it has clamp, alpha"),
        ("noisy:seed=1", "unknown option 'seed'; it has none"),
        ("nowhere/model.onnx", r"nowhere/model\.onnx: does not exist"),
        ("runs/nowhere", "'runs/nowhere' is no denoiser"),
    ],
)
def test_what_is_typed_wrong_is_named_with_what_there_is(spec: str, message: str) -> None:
    with pytest.raises(NteError, match=message):
        load_denoiser(spec)


def test_a_folder_hides_a_name_only_if_it_is_a_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "noisy").mkdir()  # such as the output of an earlier nte denoise
    assert isinstance(load_denoiser("noisy"), Noisy)
    (tmp_path / "clip").mkdir()
    with pytest.raises(NteError, match=r"'clip' is no run folder: config\.yaml is missing"):
        load_denoiser("clip")
    (tmp_path / "noisy" / "config.yaml").write_text("name: x")
    with pytest.raises(NteError, match=r"noisy/config\.yaml: "):
        load_denoiser("noisy")


@pytest.mark.parametrize("device", ["cuda", "cuda:3", "abacus"])
def test_a_device_that_is_not_there_is_named(device: str) -> None:
    if torch.cuda.is_available():
        pytest.skip("it is there")
    with pytest.raises(NteError, match=f"--device {device}: ") as error:
        load_denoiser("taa", device)
    assert "\n" not in str(error.value)
    assert isinstance(load_denoiser("noisy", device), Noisy)  # which needs none


@pytest.mark.parametrize(
    ("device", "provider"),
    [
        ("cpu", ("CPUExecutionProvider", {})),
        ("cuda", ("CUDAExecutionProvider", {})),
        ("cuda:0", ("CUDAExecutionProvider", {"device_id": "0"})),
        ("cuda:1", ("CUDAExecutionProvider", {"device_id": "1"})),
        ("rocm:12", ("ROCMExecutionProvider", {"device_id": "12"})),
        ("cpu:0", ("CPUExecutionProvider", {})),
    ],
)
def test_the_number_of_a_device_reaches_onnx_runtime(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, device: str, provider: tuple[str, dict[str, str]]
) -> None:
    """On a machine without that device: what ONNX Runtime would be asked for."""
    asked = []

    def session(path: str, options: Any, providers: Any) -> None:
        asked.extend(providers)
        raise RuntimeError("no such device here")

    monkeypatch.setattr(onnxruntime, "InferenceSession", session)
    monkeypatch.setattr(onnxruntime, "get_available_providers", lambda: [provider[0]])
    (tmp_path / "model.onnx").touch()
    with pytest.raises(NteError, match="no such device here"):
        load_denoiser(str(tmp_path / "model.onnx"), device)
    assert asked == [provider]


@pytest.mark.parametrize("device", ["cuda:", "cuda:x", "cuda:-1"])
def test_a_device_number_that_is_none_is_said(tmp_path: Path, device: str) -> None:
    (tmp_path / "model.onnx").touch()
    with pytest.raises(NteError, match=f"--device {device}: .* is no number of a device"):
        load_denoiser(str(tmp_path / "model.onnx"), device)
