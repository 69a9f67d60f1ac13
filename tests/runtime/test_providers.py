"""Where a model runs: nothing falls back in silence, and the state stays where it is computed."""

import tracemalloc
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import pytest
from onnxruntime import OrtValue

from nte.cli import main
from nte.errors import NteError
from nte.frames.frame import Frame
from nte.registry import load_denoiser
from nte.runtime.onnx_engine import spent_in
from nte.runtime.placement import placement
from nte.runtime.providers import PROVIDERS, OnnxOptions, asked_of_onnx_runtime, installed
from nte.runtime.session import OnnxDenoiser
from nte.session import Session
from tests.synthetic import disc_clip, random_frames

ELSEWHERE = [name for name in PROVIDERS if name not in ("cpu", "openvino")]


def images(denoiser: OnnxDenoiser, frames: list[Frame]) -> list[np.ndarray]:
    session = Session(denoiser)
    return [session.denoise(frame) for frame in frames]


@pytest.mark.parametrize("provider", ELSEWHERE)
def test_a_provider_that_is_not_installed_is_told_with_its_package(model: Path, provider: str) -> None:
    if PROVIDERS[provider].name in onnxruntime.get_available_providers():
        pytest.skip("it is installed")
    with pytest.raises(
        NteError, match=f"provider {provider} is not installed; there is cpu.*{PROVIDERS[provider].package}"
    ):
        OnnxDenoiser(model, OnnxOptions(provider=provider))


def test_the_command_line_says_so_too(model: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    if "CUDAExecutionProvider" in onnxruntime.get_available_providers():
        pytest.skip("it is installed")
    clip = disc_clip(tmp_path / "clip", frames=1)
    arguments = ["denoise", str(clip), "--out", str(tmp_path / "out"), "--provider", "cuda", "--denoiser"]
    assert main([*arguments, str(model)]) == 2
    said = capsys.readouterr().err
    assert len(said.splitlines()) == 1
    assert "pip install onnxruntime-gpu" in said
    assert main([*arguments, "noisy"]) == 2
    assert "--provider cuda: no exported model" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_session_on_another_provider_than_was_asked_for_is_refused(
    model: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """CUDA is in the package, but the machine has none: ONNX Runtime itself would only warn."""
    real = onnxruntime.InferenceSession
    monkeypatch.setattr(onnxruntime, "get_available_providers", lambda: [*map(first_of, PROVIDERS)])
    monkeypatch.setattr(onnxruntime, "InferenceSession", lambda path, options, providers, **_: real(path, options))
    with pytest.raises(NteError, match=r"cuda did not start; ONNX Runtime would use .*CPUExecutionProvider instead"):
        OnnxDenoiser(model, OnnxOptions(provider="cuda"))


def first_of(provider: str) -> str:
    return PROVIDERS[provider].name


def test_the_provider_that_failed_is_named(model: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object, **__: object) -> None:
        raise RuntimeError("libcudart.so: cannot open\nmore")

    monkeypatch.setattr(onnxruntime, "get_available_providers", lambda: [*map(first_of, PROVIDERS)])
    monkeypatch.setattr(onnxruntime, "InferenceSession", fail)
    with pytest.raises(NteError, match=r"model\.onnx: cuda cannot run it: libcudart\.so: cannot open$"):
        OnnxDenoiser(model, OnnxOptions(provider="cuda"))


def test_each_provider_leaves_the_rest_to_the_cpu() -> None:
    for provider in ELSEWHERE:
        asked = [name for name, _ in asked_of_onnx_runtime(OnnxOptions(provider=provider))]
        assert asked[0] == PROVIDERS[provider].name
        assert asked[-1] == "CPUExecutionProvider"


def changed(model: Path, out: Path, change: Callable[[onnx.ModelProto], object]) -> Path:
    """A copy of the model with a change, without the checksum."""
    other = onnx.load(model)
    change(other)
    del other.metadata_props[:]
    onnx.save(other, out)
    return out


@pytest.mark.parametrize(
    "change",
    [
        lambda model: setattr(model.graph.node[0], "op_type", "Abacus"),
        lambda model: setattr(model.opset_import[0], "version", 999),
    ],
    ids=["operator", "opset"],
)
def test_an_operator_or_an_opset_that_there_is_not(
    model: Path, tmp_path: Path, change: Callable[[onnx.ModelProto], object]
) -> None:
    with pytest.raises(NteError, match=r"m\.onnx: cpu lacks an operator of the model, or its version: ") as error:
        OnnxDenoiser(changed(model, tmp_path / "m.onnx", change))
    assert "\n" not in str(error.value)
    assert "onnxruntime_src" not in str(error.value)


def test_a_frame_that_cannot_be_computed_is_one_line(exported: OnnxDenoiser, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise RuntimeError("Failed to allocate memory for requested buffer of size 122880000\nat some line")

    (frame,) = random_frames(1)
    monkeypatch.setattr(onnxruntime.InferenceSession, "run_with_iobinding", fail)
    with pytest.raises(NteError, match=r"cannot run this frame: too little memory: another 117.2 MiB .*$"):
        exported.step(frame, None)


def test_the_state_stays_where_it_is_computed(exported: OnnxDenoiser) -> None:
    first, second = random_frames(2)
    _, state = exported.step(first, None)
    assert state.tensors
    assert all(isinstance(value, OrtValue) for value in state.tensors.values())
    _, after = exported.step(second, state)
    assert {name: value.data_ptr() for name, value in after.tensors.items()} != {
        name: value.data_ptr() for name, value in state.tensors.items()
    }


def test_an_image_that_was_handed_out_stays_as_it_was(exported: OnnxDenoiser) -> None:
    frames = random_frames(6)
    session, kept, copies = Session(exported), [], []
    for frame in frames:
        result = session.step(frame, ("alpha",))
        for image in (result.image[0, 1:], result.extras["alpha"]):  # a view of it as well
            kept.append(image)
            copies.append(image.copy())
        del result
    for image, copy in zip(kept, copies, strict=True):
        np.testing.assert_array_equal(image, copy)


def test_what_a_caller_does_with_its_arrays_changes_no_state(exported: OnnxDenoiser) -> None:
    frames = random_frames(3)
    expected = images(exported, frames)
    session, given = Session(exported), {name: values.copy() for name, values in frames[0].channels.items()}
    for frame, image in zip(frames, expected, strict=True):  # an engine fills the same buffers in every frame
        for name, values in frame.channels.items():
            given[name][:] = values
        found = session.denoise(Frame(given, frame.index))
        np.testing.assert_array_equal(found, image)
        found[:] = np.nan


def test_a_state_can_branch(exported: OnnxDenoiser) -> None:
    frames = random_frames(5)
    _, state = exported.step(frames[0], None)
    for other in frames[1:3]:
        exported.step(other, state)
    branches = []
    for _ in range(2):
        branch, found = state, []
        for frame in frames[3:]:
            result, branch = exported.step(frame, branch)
            found.append(result.image)
        branches.append(found)
    np.testing.assert_array_equal(branches[0], branches[1])


def test_two_sequences_share_a_model(exported: OnnxDenoiser) -> None:
    ways = [random_frames(4), random_frames(4, size=(33, 17), batch=2)]
    ways[1][0].channels["color"][:] *= 3
    alone = [images(exported, frames) for frames in ways]
    sessions = [Session(exported), Session(exported)]
    turns = [
        [session.denoise(f) for session, f in zip(sessions, pair, strict=True)] for pair in zip(*ways, strict=True)
    ]
    for turn, expected in zip(turns, zip(*alone, strict=True), strict=True):
        for image, other in zip(turn, expected, strict=True):
            np.testing.assert_array_equal(image, other)

    with ThreadPoolExecutor(2) as threads:
        together = list(threads.map(lambda frames: images(exported, frames), ways))
    np.testing.assert_equal(together, alone)


def resident_bytes() -> int:
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096


@pytest.mark.skipif(not Path("/proc/self/statm").is_file(), reason="memory is read as Linux tells it")
@pytest.mark.parametrize("provider", [name for name in ("cpu", "openvino") if name in installed()])
def test_nothing_grows_after_the_second_frame(model: Path, provider: str) -> None:
    frames = random_frames(2, size=(64, 96))  # an image has 74 kB: 50 that stay are 3.7 MB
    session = Session(load_denoiser(f"{model}:provider={provider},threads=1"))
    tracemalloc.start()
    try:
        for frame in (*frames, *frames):  # so that the state that goes was counted as well
            session.denoise(frame)
        before, resident = tracemalloc.get_traced_memory()[0], resident_bytes()
        for index in range(50):
            session.denoise(frames[index % 2])
        traced = tracemalloc.get_traced_memory()[0] - before
    finally:
        tracemalloc.stop()
    assert traced < 50_000  # free lists of Python that fill; a state has twice as much
    assert resident_bytes() - resident < 2e6


def test_a_profile_of_onnx_runtime_is_read_run_by_run() -> None:
    def ran(name: str, begin: int, microseconds: int) -> dict[str, object]:
        return {"cat": "Node", "name": f"{name}_kernel_time", "ts": begin, "dur": microseconds}

    def run(begin: int, factor: int) -> list[dict[str, object]]:
        return [
            ran("/kernels/Mul", begin + 3, 50 * factor),
            ran("/network/unet/Conv", begin, 30 * factor),
            {"cat": "Session", "name": "model_run", "ts": begin, "dur": 99},
            {"cat": "Node", "name": "/kernels/Mul_fence_before", "ts": begin + 3, "dur": 1000},
            # What a branch takes is there once more, operator by operator.
            {**ran("/kernels/If", begin + 3, 1000), "args": {"op_name": "If"}},
        ]

    events = [{"cat": "Session", "name": "session_initialization", "ts": 0, "dur": 5}, *run(10, 100), *run(200, 1)]
    assert spent_in(events) == [
        [("/network/unet/Conv", 3.0), ("/kernels/Mul", 5.0)],
        [("/network/unet/Conv", 0.03), ("/kernels/Mul", 0.05)],
    ]


def test_openvino_is_asked_for_only_where_it_is(model: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("nte.runtime.providers._has_openvino", lambda: False)
    with pytest.raises(
        NteError, match=r"openvino is not installed; there is cpu.*pip install 'nte-denoiser\[openvino\]'"
    ):
        OnnxDenoiser(model, OnnxOptions(provider="openvino"))


def test_an_openvino_that_cannot_be_imported_is_one_line(model: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(name: str) -> None:
        raise ImportError("libtbb.so.12: cannot open shared object file\nmore")

    monkeypatch.setattr("nte.runtime.providers._has_openvino", lambda: True)
    monkeypatch.setattr("nte.runtime.providers.import_module", fail)
    for use in (lambda: OnnxDenoiser(model, OnnxOptions("openvino")), lambda: placement(model, "openvino")):
        with pytest.raises(NteError, match=r"openvino is installed, but cannot be imported: libtbb\.so\.12") as said:
            use()
        assert "\n" not in str(said.value)
