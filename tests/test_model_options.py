"""The options behind an exported model's name: what reaches ONNX Runtime, and what is refused."""

import os
from hashlib import sha256
from pathlib import Path
from typing import Any

import onnxruntime
import pytest

from nte.errors import NteError
from nte.registry import load_denoiser, model_of, parts_of, with_provider
from nte.runtime.cache import engine_options

CORES = os.cpu_count() or 1
CONTENT = b"\x3a\x00"  # of a model with an empty graph
CACHE = "nte/tensorrt/" + sha256(CONTENT).hexdigest()
KEPT = {"trt_engine_cache_enable": "1", "trt_engine_cache_path": CACHE}


@pytest.mark.parametrize(
    ("spec", "device", "first"),
    [
        ("", "cpu", ("CPUExecutionProvider", {})),
        ("", "cpu:0", ("CPUExecutionProvider", {})),
        ("", "cuda", ("CUDAExecutionProvider", {"use_tf32": "0", "device_id": "0"})),
        ("", "cuda:1", ("CUDAExecutionProvider", {"use_tf32": "0", "device_id": "1"})),
        (":provider=tensorrt", "cuda:1", ("TensorrtExecutionProvider", {"device_id": "1", **KEPT})),
        (":provider=directml,index=2", "cpu", ("DmlExecutionProvider", {"device_id": "2"})),
        (":provider=cuda,index=3", "cuda:1", ("CUDAExecutionProvider", {"use_tf32": "0", "device_id": "3"})),
        (":provider=cpu", "cuda:1", ("CPUExecutionProvider", {})),
        (":provider=coreml", "cpu", ("CoreMLExecutionProvider", {"ModelFormat": "MLProgram"})),
        (":threads=1", "cpu", ("CPUExecutionProvider", {})),
    ],
)
def test_provider_and_device_reach_onnx_runtime(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, spec: str, device: str, first: tuple[str, dict[str, str]]
) -> None:
    """On a machine without that device: what ONNX Runtime would be asked for."""
    asked, threads = [], []

    def session(path: str, options: Any, providers: Any, enable_fallback: int) -> None:
        assert not enable_fallback
        asked.extend(providers)
        threads.append(options.intra_op_num_threads)
        raise RuntimeError("no such device here")

    monkeypatch.setattr(onnxruntime, "InferenceSession", session)
    monkeypatch.setattr(onnxruntime, "get_available_providers", lambda: [first[0]])
    monkeypatch.setenv("XDG_CACHE_HOME", ".")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "model.onnx").write_bytes(CONTENT)
    with pytest.raises(NteError, match="no such device here"):
        load_denoiser(f"{tmp_path / 'model.onnx'}{spec}", device)
    assert asked[0] == first
    assert threads == [1 if "threads" in spec else 0]
    assert Path(CACHE).is_dir() == ("tensorrt" in spec)  # ONNX Runtime makes no folders above the last one
    names = [name for name, _ in asked]
    assert names[-1] == "CPUExecutionProvider"
    assert len(names) == len(set(names))
    assert ("CUDAExecutionProvider" in names) == (first[0] in ("CUDAExecutionProvider", "TensorrtExecutionProvider"))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ("provider=abacus", "provider is 'abacus', expected one of cpu, openvino, cuda"),
        ("threads=0", f"threads is 0, expected auto, or a whole number from 1 to {CORES}, the cores of this machine"),
        (f"threads={CORES + 1}", f"threads is {CORES + 1}, expected auto"),
        ("threads=-2", "threads is -2, expected auto"),
        ("threads=5000", "threads is 5000, expected auto"),
        ("threads=two", "threads is 'two', expected auto"),
        ("index=-1", "index is -1, expected a number of a device, 0 or more"),
        ("index=1", "index is 1, but cpu has one device"),
        ("precision=bf16", "precision is bf16, which only openvino has, not cpu"),
        ("precision=f8", "precision is 'f8', expected one of f32, bf16"),
        ("speed=9", "unknown option 'speed', expected one of provider, index, threads, precision"),
        ("fast", "'fast' is no option: expected name:key=value"),
    ],
)
def test_options_of_a_model_that_cannot_be(tmp_path: Path, options: str, message: str) -> None:
    (tmp_path / "model.onnx").touch()
    with pytest.raises(NteError, match=message) as error:
        load_denoiser(f"{tmp_path / 'model.onnx'}:{options}")
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("kind", ["cpu", "openvino"])
def test_the_number_of_a_device_is_not_dropped(tmp_path: Path, kind: str) -> None:
    (tmp_path / "model.onnx").touch()
    with pytest.raises(NteError, match=f"index is 1, but {kind} has one device"):
        load_denoiser(str(tmp_path / "model.onnx"), f"{kind}:1")


def test_tensorrt_does_without_a_home_that_cannot_be_written_to(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "model.onnx").write_bytes(CONTENT)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "model.onnx"))
    assert engine_options(tmp_path / "model.onnx") == {}


def test_what_runs_on_a_provider_is_in_the_specification() -> None:
    changed = {
        "m.onnx": "m.onnx:provider=cuda",
        "runs/a:b/m.onnx:threads=2": "runs/a:b/m.onnx:provider=cuda,threads=2",
        "m.onnx:provider=cpu": "m.onnx:provider=cpu",
        "svgf:alpha=0.2": "svgf:alpha=0.2",
        "estimate:noise=0.1+m.onnx": "estimate:noise=0.1+m.onnx:provider=cuda",
        "composite:visibility=taa,glossy=[g.onnx:threads=1,index=0],indirect=i.onnx": (
            "composite:visibility=[taa],glossy=[g.onnx:provider=cuda,threads=1,index=0],indirect=[i.onnx:provider=cuda]"
        ),
    }
    assert with_provider(list(changed), "cuda") == list(changed.values())
    assert parts_of(changed["estimate:noise=0.1+m.onnx"]) == ["m.onnx"]
    assert parts_of("composite:visibility=taa,glossy=[estimate+g.onnx:threads=1],indirect=i.onnx") == [
        "taa", "g.onnx", "i.onnx",
    ]  # fmt: skip
    with pytest.raises(NteError, match=r"--provider cuda: no exported model \(\.onnx\) among noisy, taa"):
        with_provider(["noisy", "taa"], "cuda")


def test_a_file_whose_name_has_options_is_that_file(tmp_path: Path) -> None:
    name = str(tmp_path / "a.onnx:provider=cpu" / "b.onnx")
    assert model_of(name) == (Path(name), "")
    assert model_of(str(tmp_path / "b.onnx.bak")) is None
    assert model_of("taa:alpha=0.2") is None


@pytest.mark.parametrize("device", ["cuda:", "cuda:x", "cuda:-1"])
def test_a_device_number_that_is_none_is_said(tmp_path: Path, device: str) -> None:
    (tmp_path / "model.onnx").touch()
    with pytest.raises(NteError, match=f"--device {device}: .* is no number of a device"):
        load_denoiser(str(tmp_path / "model.onnx"), device)
