"""A model of lower precision gives nearly the same image, and nothing but its network computes otherwise."""

import copy
import json
import shutil
from collections import Counter
from pathlib import Path
from typing import Literal

import numpy as np
import onnx
import onnxruntime
import pytest
from onnx import TensorProto, helper, numpy_helper

from nte.cli import main
from nte.denoiser import Denoiser
from nte.errors import NteError
from nte.filters.prior import complete
from nte.frames.clip import Clip
from nte.models.temporal import TemporalDenoiser
from nte.released import CLIP, DEFAULT, model_path
from nte.runtime.description import METADATA_KEY, UNSEALED, seal
from nte.runtime.export import export_onnx
from nte.runtime.precision import halved, lower
from nte.runtime.providers import OnnxOptions, installed
from nte.runtime.session import OnnxDenoiser
from tests.synthetic import disc_clip, write_clip

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


def branching() -> onnx.ModelProto:
    """A graph whose branches read what lies outside: weights, and the value behind a convolution."""
    rng = np.random.default_rng(0)
    weights = [numpy_helper.from_array(rng.normal(size=(3, 3, 1, 1)).astype(np.float32), name) for name in "vw"]

    def value(name: str) -> onnx.ValueInfoProto:
        return helper.make_tensor_value_info(name, TensorProto.FLOAT, ["n", 3, "h", "w"])

    then = helper.make_graph([helper.make_node("Conv", ["behind", "v"], ["there"])], "then", [], [value("there")])
    other = helper.make_graph([helper.make_node("Identity", ["behind"], ["same"])], "other", [], [value("same")])
    nodes = [
        helper.make_node("Conv", ["x", "w"], ["seen"]),
        helper.make_node("Relu", ["seen"], ["behind"]),
        helper.make_node("ReduceMax", ["x"], ["most"], keepdims=0),
        helper.make_node("Cast", ["most"], ["light"], to=TensorProto.BOOL),
        helper.make_node("If", ["light"], ["y"], then_branch=then, else_branch=other),
    ]
    graph = helper.make_graph(nodes, "branching", [value("x")], [value("y")], weights)
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=9)


@pytest.mark.parametrize("light", [0.0, 1.0], ids=["one branch", "the other"])
def test_branches_find_what_they_read_around_them(light: float) -> None:
    x = np.linspace(-1, 1, 48, dtype=np.float32).reshape(1, 3, 4, 4) * np.float32(light)
    low, full = (
        onnxruntime.InferenceSession(graph.SerializeToString()).run(None, {"x": x})[0]
        for graph in (halved(branching()), branching())
    )
    np.testing.assert_allclose(low, full, rtol=1e-2, atol=1e-2)
    assert (light > 0) == (not np.array_equal(low, full))


def test_a_network_without_convolutions_is_refused(model: Path, tmp_path: Path) -> None:
    said = json.loads({entry.key: entry.value for entry in onnx.load(model).metadata_props}[METADATA_KEY])
    said |= {"sha256": UNSEALED, "needs": ["color"], "optional": [], "state": {}, "scales": {}}
    ends = [helper.make_tensor_value_info(name, TensorProto.FLOAT, ["n", 3, "h", "w"]) for name in ("color", "image")]
    graph = helper.make_graph([helper.make_node("Relu", ["color"], ["image"])], "plain", ends[:1], ends[1:])
    plain = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=9)
    helper.set_model_props(plain, {METADATA_KEY: json.dumps(said)})
    onnx.save(plain, tmp_path / "plain.onnx")
    seal(tmp_path / "plain.onnx")
    with pytest.raises(NteError, match=r"plain\.onnx: it has no convolutions"):
        lower(tmp_path / "plain.onnx", tmp_path / "low.onnx", "f16", **QUIET)


def test_calibration_writes_nothing_beside_the_model(model: Path, clip: Path, tmp_path: Path) -> None:
    """ONNX Runtime would write a file of this name, and remove it."""
    (tmp_path / "model").mkdir()
    copied = Path(shutil.copy(model, tmp_path / "model" / "m.onnx"))
    mine = tmp_path / "model" / "m-inferred.onnx"
    mine.write_text("mine")
    lower(copied, tmp_path / "low.onnx", "int8", [clip], **QUIET)
    assert mine.read_text() == "mine"
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["low.onnx", "m-inferred.onnx", "m.onnx", "model"]


def test_calibration_tells_its_progress_and_the_clip_that_does_not_fit(
    model: Path, clip: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    small = disc_clip(tmp_path / "small", 2, size=(12, 20), start=(5, 5), radius=3)
    with pytest.raises(NteError, match=r"small: frame 0: size \(12, 20\), expected at least 16 pixels"):
        lower(model, tmp_path / "low.onnx", "int8", [clip, small], **QUIET)
    assert f"{clip.name} (6/8 frames)" in capsys.readouterr().err
    assert not (tmp_path / "low.onnx").exists()


@pytest.mark.parametrize("light", [0.0, np.nan])
def test_a_clip_without_light_calibrates_nothing(model: Path, clip: Path, tmp_path: Path, light: float) -> None:
    """Weights would be scaled to values that no picture has, without a word."""
    frames = [frame.with_channels(color=np.full_like(frame["color"], light)) for frame in Clip(clip)]
    dark = write_clip(tmp_path / "dark", [{k: v[0] for k, v in frame.channels.items()} for frame in frames])
    with pytest.raises(
        NteError, match=r"dark: color black or NaN in all 6 frames.*: calibrate with clips that have light"
    ):
        lower(model, tmp_path / "low.onnx", "int8", [clip, dark], **QUIET)
    assert not (tmp_path / "low.onnx").exists()


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
    for source, options, message in (
        (clip, ["--precision", "f16"], "is no exported model"),
        (model, ["--calibrate", str(clip)], "--calibrate is for --precision int8"),
        (model, ["--precision", "f16", "--weights", str(tmp_path / "w.safetensors")], "--weights are a run's"),
        (model, ["--precision", "f16", "--vectors", str(tmp_path / "vectors")], "export the copy once more"),
    ):
        assert main(["export", str(source), "--out", str(out), *options]) == 2
        said = capsys.readouterr().err
        assert message in said
        assert len(said.splitlines()) == 1
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
