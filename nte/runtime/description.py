"""The description of an exported model: JSON in its metadata, checked once on loading, and the file's checksum."""

import json
import re
from collections.abc import Mapping, Sequence
from hashlib import sha256
from pathlib import Path
from typing import Any, TypeAlias

from nte.errors import NteError
from nte.frames.channels import CHANNELS, TARGETS
from nte.recurrence import FORWARD, SCALARS, Recurrent

Description: TypeAlias = dict[str, Any]  # the JSON in a model's metadata, by its keys
Shapes: TypeAlias = Mapping[str, Sequence[Any]]  # input of a graph → its shape: sizes, or names of free ones

FORMAT = "nte-onnx/2"
METADATA_KEY = "nte"
UNSEALED = "0" * 64  # placeholder of the checksum in the metadata
_SEAL = re.compile(rb'"sha256": "([0-9a-f]{64})"')


def seal(path: Path) -> None:
    """Write the checksum of a model's file into its metadata, in place of UNSEALED as `sha256`."""
    content = path.read_bytes()
    path.write_bytes(_with(content, sha256(content).hexdigest()))


def require_seal(path: Path) -> None:
    """Raise NteError for a model whose checksum does not fit; a model without a checksum passes."""
    content = path.read_bytes()
    found = _SEAL.search(content)
    if found and sha256(_with(content, UNSEALED)).hexdigest() != found[1].decode():
        raise NteError(f"{path}: damaged: its checksum does not fit: copy or export it again")


def read_description(path: Path, text: str | None, inputs: Shapes, outputs: Sequence[str]) -> Description:
    """Read and check the description of the model at `path`.

    text: the JSON in the model's metadata, or None. inputs, outputs: those of the model's graph; the exporter drops
    inputs that a network does not use, so the graph may have fewer than the description. Raises NteError if the
    description is missing, of another format, or contradicts itself or the graph.
    """
    try:
        info = json.loads(text) if text else {}
        json.dumps(info, ensure_ascii=False).encode()  # half of a surrogate pair could not be printed
    except (ValueError, RecursionError):
        info = {}
    found = info.get("format") if isinstance(info, dict) else None
    if found != FORMAT:
        what = f"{found!r:.40}" if found else "no description of ours"
        raise NteError(
            f"{path}: {what} in the model's metadata, expected '{FORMAT}': use nte export, or the nte that made it"
        )
    given: Description = {"state": None, "scales": {}, "cost": [], "macs": {}} | info
    state, scales, cost, macs = given["state"], given["scales"], given["cost"], given["macs"]
    known = {
        "version": isinstance(info.get("version"), str),
        "needs": _are_channels(info.get("needs")),
        "optional": _are_channels(info.get("optional")),
        "target": info.get("target") in TARGETS,
        "prior": isinstance(info.get("prior", ""), str),
        "precision": isinstance(info.get("precision", ""), str),
        "smallest": type(info.get("smallest")) is int and 0 < info["smallest"] < 2**16,
        "conventions": isinstance(info.get("conventions"), dict),
        "cost": isinstance(cost, list) and all(isinstance(line, str) for line in cost),
        "macs": isinstance(macs, dict) and all(type(n) in (int, float) and 0 <= n < 1e12 for n in macs.values()),
        # As `require_seal` finds it: a checksum that is damaged itself must not pass for none.
        "sha256": re.fullmatch("[0-9a-f]{64}", str(info.get("sha256"))) is not None,
        "state": isinstance(state, dict)
        and all(isinstance(source, str) and source in {*outputs, *CHANNELS, *SCALARS} for source in state.values()),
        "scales": isinstance(scales, dict) and all(type(n) is int and 0 < n < 2**16 for n in scales.values()),
    }
    if wrong := next((key for key, fits in known.items() if not fits), None):
        raise NteError(f"{path}: '{wrong}' in the model's metadata is {info.get(wrong)!r:.60}: export it again")
    taken = {*info["needs"], *info["optional"], FORWARD, *SCALARS}
    for name, shape in inputs.items():
        fits = len(shape) == 1 or (len(shape) == 4 and type(shape[1]) is int)
        if name not in taken and not (name in state and fits):
            raise NteError(f"{path}: 'state' in the model's metadata is {state!r:.60}: export it again")
    if "image" not in outputs:
        raise NteError(f"{path}: the graph has no output 'image': export it again")
    return dict(info)


def recurrent_of(info: Description, inputs: Shapes) -> dict[str, Recurrent]:
    """Return the recurrent tensors of a model, by the names of the graph's inputs.

    info: the model's description. inputs: name → shape.
    """
    scales = info.get("scales", {})
    return {
        name: Recurrent(source, inputs[name][1] if len(inputs[name]) == 4 else 0, scales.get(name, 1))
        for name, source in info["state"].items()
        if name in inputs
    }


def _are_channels(names: object) -> bool:
    return isinstance(names, list) and all(isinstance(name, str) and name in CHANNELS for name in names)


def _with(content: bytes, checksum: str) -> bytes:
    return _SEAL.sub(f'"sha256": "{checksum}"'.encode(), content, count=1)
