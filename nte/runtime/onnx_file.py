"""What an ONNX file holds, read without the package onnx: the fields of its messages, and its kinds of operators."""

from collections.abc import Iterator
from pathlib import Path

# Numbers of fields in https://github.com/onnx/onnx/blob/main/onnx/onnx.proto
GRAPH = 7  # of ModelProto
NODE = 1  # of GraphProto
KIND, ATTRIBUTE = 4, 5  # of NodeProto
BRANCH = 6  # of AttributeProto: a graph


def operators_of(path: Path) -> set[str]:
    """Return the kinds of operators in the ONNX model at `path`, those in branches as well; constants are none."""
    graphs = [content for number, content in fields(memoryview(path.read_bytes())) if number == GRAPH]
    return {kind for graph in graphs for kind in _kinds(graph)} - {"Constant"}


def fields(message: memoryview) -> Iterator[tuple[int, memoryview]]:
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


def _kinds(graph: memoryview) -> Iterator[str]:
    for number, content in fields(graph):
        for part, value in fields(content) if number == NODE else ():
            if part == KIND:
                yield bytes(value).decode(errors="replace")
            elif part == ATTRIBUTE:
                for field, inner in fields(value):
                    if field == BRANCH:
                        yield from _kinds(inner)


def _varint(message: memoryview, at: int) -> tuple[int, int]:
    """Read a number of 7 bits a byte, lowest first; return it and the place behind it."""
    value = shift = 0
    while True:
        byte = message[at]
        value, shift, at = value | (byte & 127) << shift, shift + 7, at + 1
        if byte < 128:
            return value, at
