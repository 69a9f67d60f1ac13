"""The check of a model's weights, without the package onnx."""

from pathlib import Path

import numpy as np

from nte.errors import NteError
from nte.runtime.onnx_file import GRAPH, fields

# Numbers of fields in https://github.com/onnx/onnx/blob/main/onnx/onnx.proto
INITIALIZER = 5  # of GraphProto: the weights. Constants of operators, of which some are infinite, stand elsewhere
TYPE, FLOATS, NAME, RAW = 2, 4, 8, 9  # of TensorProto
FLOAT = b"\x01"  # the type of float32


def require_finite_weights(path: Path) -> None:
    """Raise NteError if a weight of the ONNX model at `path`, which must be readable, is NaN or infinite."""
    graphs = [content for number, content in fields(memoryview(path.read_bytes())) if number == GRAPH]
    for tensor in (content for graph in graphs for number, content in fields(graph) if number == INITIALIZER):
        found = {number: bytes(content) for number, content in fields(tensor)}
        values = found.get(RAW, found.get(FLOATS, b""))
        if found.get(TYPE) == FLOAT and not np.isfinite(np.frombuffer(values, "<f4")).all():
            name = found.get(NAME, b"").decode(errors="replace")
            raise NteError(f"{path}: the weights '{name}' are not finite: export an earlier state of the training")
