"""Graphs that OpenVINO has compiled, kept in the user's cache: to read one takes a tenth of the time to compile it.

OpenVINO's own cache (CACHE_DIR) has no checksum and never forgets a graph: a damaged file can give other images.
"""

import os
from contextlib import suppress
from hashlib import sha256
from pathlib import Path

import openvino

from nte.errors import NteError
from nte.files import write_whole
from nte.runtime.cache import cache_folder

KEPT = 20  # graphs, of a few megabytes each; the one that was not used for longest goes first
_DIGEST = 32  # bytes of the checksum in front
DEVICE = "CPU"


def compiled(path: Path, settings: dict[str, str | int]) -> openvino.CompiledModel:
    """Return the graph of the ONNX model at `path`, compiled for the CPU: from the cache, else it is put there.

    settings: OpenVINO's; a kept graph fits any of them. Where nothing can be kept the graph is compiled each time.
    """
    core = openvino.Core()
    kept = cache_folder("openvino") / f"{_key(core, path)}.blob"
    with suppress(OSError, RuntimeError):  # RuntimeError: OpenVINO refuses it
        content = kept.read_bytes()
        if sha256(content[_DIGEST:]).digest() == content[:_DIGEST]:
            found = core.import_model(content[_DIGEST:], DEVICE, settings)
            os.utime(kept)
            return found
    made = core.compile_model(core.read_model(path), DEVICE, settings)
    with suppress(OSError, NteError):  # a home that cannot be written to, a full disk
        content = made.export_model().getvalue()
        kept.parent.mkdir(parents=True, exist_ok=True)
        write_whole(kept, lambda temporary: temporary.write_bytes(sha256(content).digest() + content))
        for old in sorted(kept.parent.glob("*.blob"), key=lambda file: file.stat().st_mtime)[:-KEPT]:
            old.unlink(missing_ok=True)
    return made


def _key(core: openvino.Core, path: Path) -> str:
    """What a compiled graph depends on: the model, OpenVINO, and the processor."""
    processor = core.get_property(DEVICE, "FULL_DEVICE_NAME"), core.get_property(DEVICE, "OPTIMIZATION_CAPABILITIES")
    return sha256(path.read_bytes() + f"{openvino.__version__} {processor}".encode()).hexdigest()
