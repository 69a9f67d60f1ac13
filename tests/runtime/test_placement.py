"""Which operators a provider refuses: it is asked, or its list is; branches count, and constants do not."""

from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import onnx
import onnxruntime
import pytest

from nte.info import describe
from nte.runtime.onnx_engine import session_for
from nte.runtime.onnx_file import operators_of
from nte.runtime.placement import Placement, placement
from nte.runtime.providers import PROVIDERS, OnnxOptions


def kinds(graph: onnx.GraphProto) -> Iterator[str]:
    for node in graph.node:
        yield node.op_type
        for attribute in node.attribute:
            yield from kinds(attribute.g)


def test_the_operators_of_a_file_are_those_that_onnx_reads(model: Path) -> None:
    found = operators_of(model)
    assert found == {*kinds(onnx.load(model).graph)} - {"Constant"}
    assert {"Conv", "If", "ScatterElements"} <= found  # the last stands in a branch alone


def test_the_cpu_takes_every_operator(model: Path) -> None:
    assert placement(model, "cpu") == Placement((), asked=True)
    parts = session_for(model, OnnxOptions(), record=True).get_provider_graph_assignment_info()
    asked = {node.op_type for part in parts for node in part.get_nodes()}
    assert {"Conv", "If", "ScatterElements"} <= asked  # what is counted as refused by another provider


def test_an_installed_provider_is_asked(model: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Told of a provider that is not there, every operator lies on another one."""
    cpu = session_for(model, OnnxOptions(), record=True)
    monkeypatch.setattr("nte.runtime.placement.session_for", lambda *_, **__: cpu)
    monkeypatch.setattr("nte.runtime.placement.installed", lambda: ["cpu", "webgpu"])
    monkeypatch.setattr("nte.runtime.placement.require_installed", lambda provider: None)
    found = placement(model, "webgpu")
    assert found
    assert found.asked
    assert {"Conv", "If", "ScatterElements"} <= {*found.refused}


def test_a_kind_that_is_taken_elsewhere_in_the_model_is_not_refused(
    model: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """GPU providers leave to the CPU what computes sizes, though they have the operators."""

    def part(provider: str, *kinds: str) -> SimpleNamespace:
        return SimpleNamespace(ep_name=provider, get_nodes=lambda: [SimpleNamespace(op_type=kind) for kind in kinds])

    own, cpu = part("CUDAExecutionProvider", "Conv", "Mul"), part("CPUExecutionProvider", "Mul", "IsInf", "Or")
    session = SimpleNamespace(get_provider_graph_assignment_info=lambda: [own, cpu])
    monkeypatch.setattr("nte.runtime.placement.session_for", lambda *_, **__: session)
    monkeypatch.setattr("nte.runtime.placement.installed", lambda: ["cpu", "cuda"])
    monkeypatch.setattr("nte.runtime.placement.require_installed", lambda provider: None)
    assert placement(model, "cuda") == Placement(("IsInf", "Or"), asked=True)


@pytest.mark.parametrize(
    ("provider", "refused"),
    [
        ("tensorrt", {"IsInf"}),
        ("webgpu", {"And", "GridSample", "IsNaN", "ScatterElements"}),
        ("coreml", {"If", "Where", "Pad"}),
    ],
)
def test_another_provider_is_looked_up(model: Path, provider: str, refused: set[str]) -> None:
    if PROVIDERS[provider].name in onnxruntime.get_available_providers():
        pytest.skip("it is installed")
    found = placement(model, provider)
    assert found
    assert not found.asked
    assert refused <= {*found.refused} <= operators_of(model)
    assert "Conv" not in found.refused


def test_info_says_it_of_every_provider(model: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real, started = onnxruntime.InferenceSession, []

    def session(path: str, options: object, providers: list[tuple[str, object]], **others: object) -> object:
        started.append([name for name, _ in providers])
        return real(path, options, providers=providers, **others)

    monkeypatch.setattr(onnxruntime, "InferenceSession", session)
    lines = [line.strip() for line in describe(model).splitlines()]
    assert started.count(["CPUExecutionProvider"]) == 1  # which takes half a second
    for provider in PROVIDERS:
        assert any(line.startswith(f"{provider}: ") for line in lines), provider
    assert "cpu: takes every operator" in lines
    if "TensorrtExecutionProvider" not in onnxruntime.get_available_providers():
        assert "tensorrt: not installed; by its list it refuses IsInf" in lines
