"""The check of a model's weights, without the package onnx."""

from pathlib import Path

import numpy as np

from nte.errors import NteError
from nte.runtime.onnx_file import fields, graphs_of, readable

# Numbers of fields in https://github.com/onnx/onnx/blob/main/onnx/onnx.proto
INITIALIZER = 5  # of GraphProto: the weights. Constants of operators, of which some are infinite, stand elsewhere
TYPE, FLOATS, NAME, RAW = 2, 4, 8, 9  # of TensorProto
FLOAT = b"\x01"  # the type of float32


def require_finite_weights(path: Path) -> None:
    """Raise NteError if the file at `path` is no ONNX model, or if one of its weights is NaN or infinite."""
    with readable(path):
        graphs = graphs_of(path)
        for tensor in (content for graph in graphs for number, content in fields(graph) if number == INITIALIZER):
            found = {number: bytes(content) for number, content in fields(tensor)}
            values = found.get(RAW, found.get(FLOATS, b""))
            if found.get(TYPE) == FLOAT and not np.isfinite(np.frombuffer(values, "<f4")).all():
                name = found.get(NAME, b"").decode(errors="replace")
                raise NteError(f"{path}: the weights '{name}' are not finite: export an earlier state of the training")
