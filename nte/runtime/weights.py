"""The check of a model's weights, without the package onnx: of an ONNX file it reads the few fields that hold them."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from nte.errors import NteError

# Numbers of fields in https://github.com/onnx/onnx/blob/main/onnx/onnx.proto
GRAPH = 7  # of ModelProto
INITIALIZER = 5  # of GraphProto: the weights. Constants of operators, of which some are infinite, stand elsewhere
TYPE, FLOATS, NAME, RAW = 2, 4, 8, 9  # of TensorProto
FLOAT = b"\x01"  # the type of float32


def require_finite_weights(path: Path) -> None:
    """Raise NteError if a weight of the ONNX model at `path`, which must be readable, is NaN or infinite."""
    graphs = [content for number, content in _fields(memoryview(path.read_bytes())) if number == GRAPH]
    for tensor in (content for graph in graphs for number, content in _fields(graph) if number == INITIALIZER):
        fields = {number: bytes(content) for number, content in _fields(tensor)}
        values = fields.get(RAW, fields.get(FLOATS, b""))
        if fields.get(TYPE) == FLOAT and not np.isfinite(np.frombuffer(values, "<f4")).all():
            name = fields.get(NAME, b"").decode(errors="replace")
            raise NteError(f"{path}: the weights '{name}' are not finite: export an earlier state of the training")


def _fields(message: memoryview) -> Iterator[tuple[int, memoryview]]:
    """Yield the fields of a message of Protocol Buffers: number and bytes."""
    at = 0
    while at < len(message):
        key, at = _varint(message, at)
        match key & 7:
            case 0:
                end = _varint(message, at)[1]
            case 2:
                length, at = _varint(message, at)
                end = at + length
            case wire:
                end = at + {1: 8, 5: 4}[wire]
        yield key >> 3, message[at:end]
        at = end


def _varint(message: memoryview, at: int) -> tuple[int, int]:
    """Read a number of 7 bits a byte, lowest first; return it and the place behind it."""
    value = shift = 0
    while True:
        byte = message[at]
        value, shift, at = value | (byte & 127) << shift, shift + 7, at + 1
        if byte < 128:
            return value, at
