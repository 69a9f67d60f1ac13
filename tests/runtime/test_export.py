"""Export writes one file that agrees with PyTorch, or none."""

import copy
import json
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
import torch

from nte.errors import NteError
from nte.frames.scalars import sequence_scalars
from nte.models.temporal import TemporalDenoiser
from nte.runtime import export
from nte.runtime.export import export_onnx
from nte.runtime.session import OnnxDenoiser
from nte.runtime.trial import difference
from nte.session import Session
from tests.networks import small_network
from tests.synthetic import random_frames


def test_one_file_with_free_sizes_and_its_conventions(model: Path) -> None:
    assert [path.name for path in model.parent.iterdir()] == ["model.onnx"]
    graph = onnx.load(model)
    dimensions = {i.name: [d.dim_param or d.dim_value for d in i.type.tensor_type.shape.dim] for i in graph.graph.input}
    assert dimensions == {
        "color": ["batch", 3, "height", "width"], "albedo": ["batch", 3, "height", "width"],
        "normal": ["batch", 3, "height", "width"], "depth": ["batch", 1, "height", "width"],
        "motion": ["batch", 2, "height", "width"], "previous_forward_motion": ["batch", 2, "height", "width"],
        "reset": ["batch"], "exposure": ["batch"], "depth_scale": ["batch"],
        "history": ["batch", 3, "height", "width"], "previous_depth": ["batch", 1, "height", "width"],
        "previous_exposure": ["batch"],
    }  # fmt: skip
    described = json.loads({p.key: p.value for p in graph.metadata_props}["nte"])
    assert described["format"] == "nte-onnx/2"
    assert described["needs"] == ["color", "albedo", "normal", "depth", "motion"]
    assert set(dimensions) - {*described["state"]} <= described["conventions"].keys()
    assert "NaN = unknown, 0 = stands still" in described["conventions"]["previous_forward_motion"]


@pytest.mark.slow
def test_the_same_weights_give_the_same_bytes(network: TemporalDenoiser, model: Path, tmp_path: Path) -> None:
    export_onnx(network, tmp_path / "again.onnx", progress=lambda line: None)
    assert (tmp_path / "again.onnx").read_bytes() == model.read_bytes()


def test_the_loop_that_the_page_shows_is_that_of_nte(
    model: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("demo").mkdir()
    shutil.copy(model, "demo/quickstart.onnx")
    page = (Path(__file__).parents[2] / "export" / "README.md").read_text("utf-8")
    (block,) = re.findall(r"```python\n(import json.*?)```", page, re.DOTALL)
    shown: dict[str, Any] = {}
    exec(block, shown)
    frames, session = random_frames(3, (21, 34), batch=2), Session(OnnxDenoiser(model))
    exposure, depth_scale = sequence_scalars(frames[0])
    state = shown["begin"](2, 21, 34)
    for index, frame in enumerate(frames):
        image, state = shown["denoise"](dict(frame.channels), state, index == 0, exposure, depth_scale)
        np.testing.assert_array_equal(image, session.denoise(frame))


def test_the_comparison_sees_a_difference(network: TemporalDenoiser, model: Path) -> None:
    exported = OnnxDenoiser(model)
    typical, worst = difference(exported, network, (33, 47))
    assert typical < 1e-4
    assert worst < 0.05
    other = copy.deepcopy(network)
    other.prediction.trunk.encoders[0][0].weight += 1e-3
    assert difference(exported, other, (33, 47))[0] > 1e-4


def test_a_network_that_passes_bad_pixels_on_is_told_so(
    network: TemporalDenoiser, model: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("nte.models.reading.usable_light", lambda target, light, exposure: light)
    with pytest.raises(NteError, match=r"^not exported: in frame 0 .* its forward must make its inputs usable"):
        difference(OnnxDenoiser(model), network, (33, 47))


@pytest.mark.slow
def test_a_graph_that_differs_is_not_written(
    network: TemporalDenoiser, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    wrong = copy.deepcopy(network)
    wrong.prediction.heads.heads[0].bias += torch.linspace(0, 1e-2, len(wrong.prediction.heads.heads[0].bias))
    graph = export._graph(wrong)
    monkeypatch.setattr(export, "_graph", lambda _: graph)
    with pytest.raises(NteError, match=r"model\.onnx: not written: ONNX Runtime differs from PyTorch at 96x64, 20 f"):
        export_onnx(network, tmp_path / "model.onnx", progress=lambda line: None)
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
@pytest.mark.parametrize(
    "choices",
    [{}, {"motion": "traditional", "kernel_size": 3, "downsample": "mean"}, {"temporal": False, "scales": 1}],
    ids=str,
)
def test_every_kind_of_network_can_be_exported(choices: dict[str, object], tmp_path: Path) -> None:
    network = small_network(**choices)
    said: list[str] = []
    export_onnx(network, tmp_path / "new" / "model.onnx", said.append)
    assert len(said) == 3
    exported = OnnxDenoiser(tmp_path / "new" / "model.onnx")
    ours = theirs = None
    for frame in random_frames(3, (29, 18)):
        (expected, ours), (found, theirs) = network.step(frame, ours), exported.step(frame, theirs)
        np.testing.assert_allclose(found.image, expected.image, rtol=1e-3, atol=1e-4)


def test_a_folder_in_the_way_is_one_line(network: TemporalDenoiser, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(NteError, match="file: cannot be made a folder"):
        export_onnx(network, tmp_path / "file" / "model.onnx")
