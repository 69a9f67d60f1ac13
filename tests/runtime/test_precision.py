"""A model of lower precision gives nearly the same image, and nothing but its network computes otherwise."""

import copy
from collections import Counter
from pathlib import Path
from typing import Literal

import numpy as np
import onnx
import pytest
from onnx import TensorProto

from nte.cli import main
from nte.denoiser import Denoiser
from nte.errors import NteError
from nte.filters.prior import complete
from nte.frames.clip import Clip
from nte.models.temporal import TemporalDenoiser
from nte.released import CLIP, DEFAULT, model_path
from nte.runtime.export import export_onnx
from nte.runtime.precision import halved, lower
from nte.runtime.providers import OnnxOptions, installed
from nte.runtime.session import OnnxDenoiser
from tests.synthetic import disc_clip

MASKS = ("valid", "disoccluded")
CASTS = ("Cast", "QuantizeLinear", "DequantizeLinear")
QUIET = {"progress": lambda line: None}


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return disc_clip(tmp_path_factory.mktemp("clip"), 6, 3)


@pytest.fixture(scope="module", params=["f16", "int8"])
def lowered(request: pytest.FixtureRequest, model: Path, clip: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp(request.param) / "lowered.onnx"
    return lower(model, out, request.param, [clip] if request.param == "int8" else [], **QUIET)


def apart(denoiser: Denoiser, expected: Denoiser, clip: Path, masks: tuple[str, ...] = ()) -> float:
    """The mean of |a − b| / (|b| + 0.01) over a clip; masks must be the same in every pixel."""
    ours, theirs, errors = None, None, []
    for frame in Clip(clip):
        found, ours = denoiser.step(frame, ours, masks)
        target, theirs = expected.step(frame, theirs, masks)
        errors.append(np.abs(found.image - target.image) / (np.abs(target.image) + 0.01))
        for name in masks:
            np.testing.assert_array_equal(found.extras[name], target.extras[name])
    return float(np.mean(errors))


@pytest.mark.parametrize("provider", ["cpu", "openvino"])
def test_the_image_is_nearly_the_same_and_masks_are_the_same(
    model: Path, lowered: Path, clip: Path, provider: Literal["cpu", "openvino"]
) -> None:
    if provider not in installed():
        pytest.skip(f"{provider} is not installed")
    low = OnnxDenoiser(lowered, OnnxOptions(provider=provider))
    assert 0 < apart(low, OnnxDenoiser(model), clip, MASKS) < 0.01


def test_only_convolutions_and_what_lies_between_them_change(model: Path, lowered: Path) -> None:
    before, after = (onnx.load(path).graph for path in (model, lowered))
    kinds = [Counter(node.op_type for node in graph.node if node.op_type not in CASTS) for graph in (before, after)]
    assert kinds[0] == kinds[1]
    assert [value.name for value in after.output] == [value.name for value in before.output]
    assert [*after.input] == [*before.input]
    weights = {tensor.name: tensor.data_type for tensor in after.initializer}
    made = {name: node for node in after.node for name in node.output}
    for node in after.node:
        if node.op_type == "Conv":
            name = node.input[1]
            stored = made[name].input[0] if name in made else name  # bytes stand behind their scale
            assert weights[stored] in (TensorProto.FLOAT16, TensorProto.INT8)


def test_values_that_the_network_shows_to_others_are_cast_back(model: Path) -> None:
    """In float16 a graph has as many casts as it has borders: no value is cast there and back in between."""
    graph = halved(onnx.load(model)).graph
    casts = [node for node in graph.node if node.name.endswith("/Cast") and "/f16" in node.name + node.input[0]]
    back = {node.input[0] for node in casts if node.input[0].endswith("/f16")}
    readers = {name for node in graph.node if node.op_type in ("Relu", "MaxPool", "Conv") for name in node.input}
    assert back
    assert not readers & {node.output[0] for node in casts if node.input[0] in back}


def test_the_released_model_in_bytes_is_calibrated_with_what_lies_below_it(tmp_path: Path) -> None:
    pytest.importorskip("pyoidn")
    out = tmp_path / "new" / "steady8.onnx"
    main(["export", DEFAULT, "--out", str(out), "--precision", "int8", "--calibrate", str(CLIP)])
    released = model_path(DEFAULT)
    assert released is not None
    low, full = (complete(OnnxDenoiser(path)) for path in (out, released))
    assert 0 < apart(low, full, CLIP) < 0.01


def test_a_lower_precision_is_told(lowered: Path, capsys: pytest.CaptureFixture[str]) -> None:
    main(["info", str(lowered)])
    precision = OnnxDenoiser(lowered).info["precision"]
    assert f"  the network computes in {precision}" in capsys.readouterr().out


def test_what_cannot_be_lowered_is_refused(
    model: Path, lowered: Path, clip: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out.onnx"
    with pytest.raises(NteError, match="int8 needs some"):
        lower(model, out, "int8")
    with pytest.raises(NteError, match="f16 none"):
        lower(model, out, "f16", [clip])
    with pytest.raises(NteError, match="already"):
        lower(lowered, out, "f16")
    with pytest.raises(NteError, match="exists"):
        lower(model, lowered, "f16")
    assert main(["export", str(clip), "--out", str(out), "--precision", "f16"]) == 2
    assert "is no exported model" in capsys.readouterr().err
    assert not out.exists()


def test_a_network_that_float16_cannot_hold_is_not_written(network: TemporalDenoiser, tmp_path: Path) -> None:
    """Features above 65504 become infinite, and the difference of two of them NaN."""
    huge = copy.deepcopy(network)
    first = huge.prediction.trunk.encoders[0]
    first[0].bias.fill_(1e5)
    first[2].weight.mul_(1e-5)
    export_onnx(huge, tmp_path / "huge.onnx", **QUIET)
    with pytest.raises(NteError, match=r"low\.onnx: not written: in f16 the image is NaN or infinite"):
        lower(tmp_path / "huge.onnx", tmp_path / "low.onnx", "f16", **QUIET)
    assert [path.name for path in tmp_path.iterdir()] == ["huge.onnx"]
