"""What OpenVINO compiled is read again as long as it fits and is whole, by any number of processes."""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from hashlib import sha256
from pathlib import Path
from typing import Literal

import numpy as np
import onnx
import pytest

from nte.runtime.description import UNSEALED, seal
from nte.runtime.providers import OnnxOptions
from nte.runtime.session import OnnxDenoiser
from nte.session import Session
from tests.synthetic import random_frames

openvino = pytest.importorskip("openvino")
pytestmark = pytest.mark.slow


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of kept graphs, in an empty cache."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache" / "nte" / "openvino"


@pytest.fixture
def compilations(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Has an entry for each graph that was compiled."""
    real, done = openvino.Core.compile_model, []

    def compile_model(*given: object, **named: object) -> object:
        done.append("once")
        return real(*given, **named)

    monkeypatch.setattr(openvino.Core, "compile_model", compile_model)
    return done


def images(model: Path, threads: int | None = 1, precision: Literal["f32", "bf16"] = "f32") -> list[np.ndarray]:
    session = Session(OnnxDenoiser(model, OnnxOptions("openvino", threads=threads, precision=precision)))
    return [session.denoise(frame) for frame in random_frames(3, size=(24, 33))]


def test_a_graph_is_compiled_once(model: Path, cache: Path, compilations: list[str]) -> None:
    first = images(model)
    (kept,) = cache.iterdir()
    np.testing.assert_array_equal(images(model), first)
    np.testing.assert_allclose(images(model, threads=None), first, rtol=1e-4, atol=1e-5)
    again = OnnxDenoiser(model, OnnxOptions(provider="openvino"))
    plain = OnnxDenoiser(model)
    assert (again.needs, again.optional, again.extras, again.info) == (
        plain.needs, plain.optional, plain.extras, plain.info,
    )  # fmt: skip
    assert len(compilations) == 1
    assert [*cache.iterdir()] == [kept]


def test_a_kept_graph_computes_in_the_type_that_is_asked_for(model: Path, cache: Path) -> None:
    if "BF16" not in openvino.Core().get_property("CPU", "OPTIMIZATION_CAPABILITIES"):
        pytest.skip("this processor has no bfloat16")
    exact = images(model)
    half = images(model, precision="bf16")
    assert not np.array_equal(half, exact)
    for path in cache.iterdir():
        path.unlink()
    np.testing.assert_array_equal(images(model, precision="bf16"), half)
    np.testing.assert_array_equal(images(model), exact)


def test_other_weights_are_another_graph(model: Path, tmp_path: Path, cache: Path, compilations: list[str]) -> None:
    changed = onnx.load(model)
    for tensor in changed.graph.initializer:
        if tensor.name.endswith("weight"):
            values = onnx.numpy_helper.to_array(tensor)
            tensor.CopyFrom(onnx.numpy_helper.from_array(values * np.float32(1.01), tensor.name))
    described = {entry.key: entry.value for entry in changed.metadata_props}["nte"]
    start = described.index('"sha256": "') + len('"sha256": "')
    onnx.helper.set_model_props(changed, {"nte": described[:start] + UNSEALED + described[start + 64 :]})
    onnx.save(changed, tmp_path / "changed.onnx")
    seal(tmp_path / "changed.onnx")
    assert not np.array_equal(images(model), images(tmp_path / "changed.onnx"))
    assert len(compilations) == len([*cache.iterdir()]) == 2


def flipped(content: bytes) -> bytes:
    changed = bytearray(content)
    changed[len(content) // 2] ^= 64
    return bytes(changed)


@pytest.mark.parametrize(
    "damage", [lambda content: b"", lambda content: content[:5], lambda content: content[:-9], flipped],
    ids=["empty", "a part of the checksum", "cut", "one bit"],
)  # fmt: skip
def test_a_damaged_graph_is_compiled_anew(
    model: Path, cache: Path, compilations: list[str], damage: Callable[[bytes], bytes]
) -> None:
    first = images(model)
    (kept,) = cache.iterdir()
    kept.write_bytes(damage(kept.read_bytes()))
    for _ in range(2):
        np.testing.assert_array_equal(images(model), first)
    assert len(compilations) == 2


def test_a_graph_that_openvino_refuses_is_compiled_anew(model: Path, cache: Path, compilations: list[str]) -> None:
    """As after an update that keeps its number."""
    first = images(model)
    (kept,) = cache.iterdir()
    content = b"of another build" * 9
    kept.write_bytes(sha256(content).digest() + content)
    np.testing.assert_array_equal(images(model), first)
    assert len(compilations) == 2


def test_a_home_that_cannot_be_written_to_is_no_error(
    model: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    assert len(images(model)) == 3


def test_the_graphs_that_were_not_used_for_longest_go(
    model: Path, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("nte.runtime.openvino_cache.KEPT", 2)
    cache.mkdir(parents=True)
    for age, name in enumerate(("newest", "old", "oldest")):
        (cache / f"{name}.blob").touch()
        stamp = (cache / f"{name}.blob").stat().st_mtime - 1000 * (age + 1)
        os.utime(cache / f"{name}.blob", (stamp, stamp))
    images(model)
    names = {path.stem for path in cache.iterdir()}
    assert len(names) == 2
    assert "newest" in names


def test_two_at_once_share_a_cache(model: Path, cache: Path) -> None:
    with ThreadPoolExecutor(2) as threads:
        found = list(threads.map(lambda _: images(model), range(2)))
    np.testing.assert_array_equal(found[0], found[1])
    assert len([*cache.iterdir()]) == 1
