"""ONNX files are read without the package onnx as it reads them, and any other bytes are refused in one line."""

from pathlib import Path

import onnx
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nte.errors import NteError
from nte.runtime.onnx_file import fields, metadata_of, operators_of
from nte.runtime.session import OnnxDenoiser


def test_metadata_is_what_onnx_reads(model: Path, tmp_path: Path) -> None:
    written = {entry.key: entry.value for entry in onnx.load(model).metadata_props}
    assert metadata_of(model, "nte") == written["nte"]
    assert metadata_of(model, "author") is None
    other = onnx.load(model)
    onnx.helper.set_model_props(other, {"empty": "", "author": "Ødegård"})
    onnx.save(other, tmp_path / "other.onnx")
    assert metadata_of(tmp_path / "other.onnx", "author") == "Ødegård"
    assert metadata_of(tmp_path / "other.onnx", "nte") is None


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"", "it has no graph"),
        (b"hello", "a field has the type 4"),
        (b"\x89PNG\r\n\x1a\n" + b"x" * 400, "it "),
        (bytes(1000), "it has no graph"),
        (b"\xff" * 2_000_000, "too long"),  # to read it as one number would take hours
        (b"\x3a\x05ab", "it ends within a field"),
    ],
)
def test_other_bytes_are_refused_in_one_line(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], content: bytes, reason: str
) -> None:
    path = tmp_path / "m.onnx"
    path.write_bytes(content)
    for read in (operators_of, OnnxDenoiser, lambda path: metadata_of(path, "nte")):
        with pytest.raises(NteError, match=rf"m\.onnx: not a readable ONNX model: .*({reason})") as error:
            read(path)
        assert "\n" not in str(error.value)
    assert capfd.readouterr() == ("", "")


@given(st.binary(max_size=200))
def test_any_bytes_are_fields_or_a_value_error(content: bytes) -> None:
    try:
        found = list(fields(memoryview(content)))
    except ValueError:
        return
    assert sum(len(value) for _, value in found) <= len(content)
