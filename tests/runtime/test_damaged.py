"""Files that are no model of ours, or a damaged one: each is one line that names what does not fit."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import onnx
import pytest

from nte.errors import NteError
from nte.runtime.description import UNSEALED, seal
from nte.runtime.session import OnnxDenoiser
from nte.runtime.weights import require_finite_weights


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("target", "nope"), ("target", None), ("target", ["color"]), ("needs", "color"), ("needs", [1]),
        ("needs", ["colour"]), ("optional", None), ("smallest", "16"), ("smallest", -1), ("smallest", True),
        ("state", {}), ("state", []), ("state", {"history": "nowhere"}), ("state", {"history": 3}),
        ("state", {"history": "image", "more": "image"}), ("version", 1), ("conventions", []), ("sha256", None),
    ],
)  # fmt: skip
def test_a_description_that_cannot_be_is_refused(model: Path, tmp_path: Path, key: str, value: object) -> None:
    said = onnx.load(model)
    described = json.loads({p.key: p.value for p in said.metadata_props}["nte"])
    onnx.helper.set_model_props(said, {"nte": json.dumps(described | {"sha256": UNSEALED, key: value})})
    onnx.save(said, tmp_path / "said.onnx")
    seal(tmp_path / "said.onnx")
    with pytest.raises(NteError, match=rf"said\.onnx: '{key}' in the model's metadata is ") as error:
        OnnxDenoiser(tmp_path / "said.onnx")
    assert "\n" not in str(error.value)


def test_damage_to_the_checksum_does_not_switch_it_off(model: Path, tmp_path: Path) -> None:
    content = model.read_bytes()
    start = content.index(b'"sha256": "') + len(b'"sha256": "')
    letter = next(i for i in range(start, start + 64) if content[i : i + 1].isalpha())
    damaged = tmp_path / "damaged.onnx"
    damaged.write_bytes(content[:letter] + content[letter : letter + 1].upper() + content[letter + 1 :])
    with pytest.raises(NteError, match=r"damaged\.onnx: 'sha256' in the model's metadata is '[0-9A-Fa-f]*"):
        OnnxDenoiser(damaged)


def of_nan(weights: np.ndarray) -> np.ndarray:
    weights = weights.copy()
    weights[-1, 0] = np.nan
    return weights


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (of_nan, "the weights 'prediction.trunk.encoders.1.0.weight' are not finite"),
        (lambda weights: weights * np.float32(np.inf), "the weights '.*' are not finite"),
        (lambda weights: weights.astype(np.int32), "not a readable ONNX model"),
        (lambda weights: weights.view(np.int32), "not a readable ONNX model"),
        (lambda weights: weights.astype(np.float64), "not a readable ONNX model"),
    ],
    ids=["NaN", "Inf", "int32", "bits of int32", "float64"],
)
@pytest.mark.parametrize("sealed", [True, False], ids=["sealed anew", "old checksum"])
def test_weights_that_cannot_be_are_refused(
    model: Path, tmp_path: Path, change: Callable[[np.ndarray], np.ndarray], message: str, sealed: bool
) -> None:
    spoilt = onnx.load(model)
    (weights,) = [tensor for tensor in spoilt.graph.initializer if tensor.name.endswith("encoders.1.0.weight")]
    weights.CopyFrom(onnx.numpy_helper.from_array(change(onnx.numpy_helper.to_array(weights)), weights.name))
    if sealed:
        described = json.loads({p.key: p.value for p in spoilt.metadata_props}["nte"])
        onnx.helper.set_model_props(spoilt, {"nte": json.dumps(described | {"sha256": UNSEALED})})
    path = tmp_path / "spoilt.onnx"
    onnx.save(spoilt, path)
    if sealed:
        seal(path)
    with pytest.raises(NteError, match=rf"spoilt\.onnx: {message if sealed else 'damaged: its checksum'}") as error:
        OnnxDenoiser(path)
    assert "\n" not in str(error.value)


def test_weights_that_are_listed_one_by_one_are_looked_at_too(model: Path, tmp_path: Path) -> None:
    listed, path = onnx.load(model), tmp_path / "listed.onnx"
    for tensor in listed.graph.initializer:
        values = onnx.numpy_helper.to_array(tensor)
        tensor.CopyFrom(onnx.helper.make_tensor(tensor.name, tensor.data_type, tensor.dims, values.ravel()))
    onnx.save(listed, path)
    require_finite_weights(path)
    listed.graph.initializer[0].float_data[3] = np.nan
    onnx.save(listed, path)
    with pytest.raises(NteError, match=r"listed\.onnx: the weights 'prediction\..*' are not finite"):
        require_finite_weights(path)


def test_files_that_are_no_model_of_ours(model: Path, tmp_path: Path) -> None:
    foreign = onnx.load(model)
    for metadata in ({}, {"nte": "not JSON"}, {"nte": "[1]"}, {"nte": json.dumps({"format": "nte-onnx/9\n\x1b"})}):
        onnx.helper.set_model_props(foreign, metadata)
        onnx.save(foreign, tmp_path / "foreign.onnx")
        with pytest.raises(NteError, match=r"foreign\.onnx: .* in the model's metadata, expected 'nte-onnx/2'") as said:
            OnnxDenoiser(tmp_path / "foreign.onnx")
        assert str(said.value).isprintable()
    whole = model.read_bytes()
    flipped = bytearray(whole)
    flipped[len(whole) // 2] ^= 1  # in the weights: a model that runs, and denoises otherwise
    for content in (b"", b"no model", whole[:-500], whole[:-100], bytes(flipped)):
        (tmp_path / "damaged.onnx").write_bytes(content)
        with pytest.raises(NteError, match=r"damaged\.onnx: (not a readable ONNX model|damaged: its check)") as error:
            OnnxDenoiser(tmp_path / "damaged.onnx")
        assert "\n" not in str(error.value)
    with pytest.raises(NteError, match=r"nowhere\.onnx: does not exist"):
        OnnxDenoiser(tmp_path / "nowhere.onnx")
    with pytest.raises(NteError, match=r"is no file; expected an .onnx file"):
        OnnxDenoiser(tmp_path)
