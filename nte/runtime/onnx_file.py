"""What an ONNX file holds, read without the package onnx: the fields of its messages, metadata, kinds of operators."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from nte.errors import NteError

# Numbers of fields in https://github.com/onnx/onnx/blob/main/onnx/onnx.proto
GRAPH, METADATA = 7, 14  # of ModelProto
KEY, VALUE = 1, 2  # of StringStringEntryProto
NODE = 1  # of GraphProto
KIND, ATTRIBUTE = 4, 5  # of NodeProto
BRANCH = 6  # of AttributeProto: a graph


def metadata_of(path: Path, key: str) -> str | None:
    """Return the text under `key` in the metadata of the ONNX model at `path`, or None.

    Raises NteError for a file that is no ONNX model.
    """
    with readable(path):
        entries = [dict(fields(content)) for number, content in _model(path) if number == METADATA]
        texts = {bytes(entry[KEY]): bytes(entry[VALUE]).decode() for entry in entries if entry.keys() >= {KEY, VALUE}}
    return texts.get(key.encode())


def operators_of(path: Path) -> set[str]:
    """Return the kinds of operators in the ONNX model at `path`, those in branches as well; constants are none.

    Raises NteError for a file that is no ONNX model.
    """
    with readable(path):
        return {kind for graph in graphs_of(path) for kind in _kinds(graph)} - {"Constant"}


def graphs_of(path: Path) -> list[memoryview]:
    """Return the graph of the ONNX model at `path`, in the pieces that it is stored in: most often one."""
    return [content for number, content in _model(path) if number == GRAPH]


@contextmanager
def readable(path: Path) -> Iterator[None]:
    """Let what cannot be read within the context, as ValueError says, be an NteError that names the file."""
    try:
        yield
    except ValueError as error:
        raise NteError(f"{path}: not a readable ONNX model: {error}") from error


def fields(message: memoryview) -> Iterator[tuple[int, memoryview]]:
    """Yield the fields of a message of Protocol Buffers: number and bytes. Raises ValueError for other bytes."""
    at = 0
    while at < len(message):
        key, at = _varint(message, at)
        match key & 7:
            case 0:
                end = _varint(message, at)[1]
            case 2:
                length, at = _varint(message, at)
                end = at + length
            case 1 | 5 as wire:
                end = at + (8 if wire == 1 else 4)
            case wire:
                raise ValueError(f"a field has the type {wire}")
        if end > len(message):
            raise ValueError("it ends within a field")
        yield key >> 3, message[at:end]
        at = end


def _model(path: Path) -> list[tuple[int, memoryview]]:
    """The fields of the whole file. Raises ValueError if it has no graph."""
    found = list(fields(memoryview(path.read_bytes())))
    if not any(number == GRAPH for number, _ in found):
        raise ValueError("it has no graph")
    return found


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
    value = 0
    for shift, byte in enumerate(message[at : at + 10]):  # 64 bits at the most
        value |= (byte & 127) << 7 * shift
        if byte < 128:
            return value, at + shift + 1
    raise ValueError("it ends within a number, or has one that is too long")
