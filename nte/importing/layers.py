"""Search for a channel's layers in a foreign EXR file, and decoding of the stored values."""

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from nte.errors import NteError
from nte.frames.channels import CHANNELS, VECTORS, Channel
from nte.frames.clip import Pixels
from nte.frames.exr import HALF_MAX, Part
from nte.importing.source import SKY, Source

Stored = Mapping[str, npt.NDArray[np.generic]]  # full layered name → (H, W), float16, float32 or uint32
_OWN = "."  # stands for the components that belong to no layer: R, G, B
# number of a layer's components → their names, in order; a channel's own are tried first; Nuke writes whole words
_SUFFIXES: dict[int, tuple[Sequence[str], ...]] = {
    2: ("xy", "rg", "uv", ("red", "green")),
    3: ("rgb", "xyz", ("red", "green", "blue")),
}
_CHROMA = {"r", "g", "b", "x", "ry", "by"}  # beside any of these, Y is not a grey image
_DARK = 1e-3  # a surface with a colour below this has no such lobe
_LISTED = 40  # largest number of a file's channels that an error names


@dataclass(frozen=True)
class Found:
    """The place of a channel in a file: the full names of the layers whose values are summed."""

    names: tuple[tuple[str, ...], ...]  # components of the channel itself, then of `plus`, then of `where_dark`
    dark_from: int  # index of the first entry that is only added in dark pixels
    part: str = ""  # name of the part that the map chooses, perhaps by its number; empty if it chooses none

    @property
    def called(self) -> str:
        """Name for the user: the layers, or the channel names if there is no layer."""
        return " + ".join(map(_common_layer, self.names)) + (f" of part {self.part}" if self.part else "")


def prefixes(stored: Stored, name: str, source: Source, ignored: Sequence[str]) -> list[str]:
    """List the prefixes under which a file has channel `name`, found by its `source`; empty if there is none.

    ignored: prefixes that count only if there is no other.
    """
    below: dict[str, dict[str, npt.NDArray[np.generic]]] = {"": dict(stored)}
    for key, pixels in stored.items():
        for match in re.finditer(r"\.", key):
            below.setdefault(key[: match.start()], {})[key] = pixels
    # Each prefix looks at its own channels only: files of thousands would take the square of that.
    fitting = sorted(prefix for prefix, own in below.items() if find(own, name, source, prefix))
    return [prefix for prefix in fitting if prefix not in ignored] or fitting


def find_prefix(path: Path, stored: Stored, name: str, source: Source, ignored: Sequence[str]) -> str:
    """Return the one prefix under which a file has channel `name`, or "" if there is none.

    ignored: prefixes that count only if there is no other. Raises NteError if several fit.
    """
    chosen = prefixes(stored, name, source, ignored)
    if len(chosen) > 1:
        raise NteError(f"{path}: has the layers {', '.join(chosen)}: choose one with prefix=NAME")
    return chosen[0] if chosen else ""


def find(stored: Stored, name: str, source: Source, prefix: str = "") -> Found | None:
    """Find channel `name` among a file's channels; return None if it is not there."""
    row = CHANNELS[name]
    own = _of_layers(stored, row, source.layer or [_OWN], prefix)
    plus = [_of_layers(stored, row, [layer], prefix) for layer in source.plus]
    dark = [_of_layers(stored, row, [layer], prefix) for layer in source.where_dark]
    everywhere = [names for names in (own, *plus) if names]
    if not everywhere:
        return None
    return Found((*everywhere, *filter(None, dark)), len(everywhere))


def partly_there(stored: Stored, source: Source, prefix: str) -> bool:
    """Tell whether a file has some of the layers that `source` names, so that a channel not found is a fault."""
    full = _alternatives((*source.layer, *source.plus), prefix)
    return any(name in stored or _below(stored, name) for name in full)


def read(stored: Stored, name: str, source: Source, found: Found, sky: float = np.inf) -> npt.NDArray[np.generic]:
    """Read and decode channel `name` (C, H, W), float32: layers are summed, then value = stored · scale + offset.

    Unknown vectors become NaN; stored depths of the size `sky` or more, or at the end of half floats, infinite. Ids are
    float64, which holds those of 32 bits.
    """
    kind = CHANNELS[name].kind
    scale, offset = (np.reshape(np.array(n, np.float64), (-1, 1, 1)) for n in (source.scale, source.offset))
    if kind == "id":
        return np.stack([stored[n] for n in found.names[0]]).astype(np.float64) * scale + offset
    layers = [np.stack([np.asarray(stored[n], np.float32) for n in names]) for names in found.names]
    values: Pixels = np.sum(layers[: found.dark_from], axis=0)
    if rest := layers[found.dark_from :]:
        values = np.where(values.max(0) < _DARK, np.sum([values, *rest], axis=0), values)
    if kind == "depth":  # what cannot be stored: the sky of writers that clamp
        end = HALF_MAX if stored[found.names[0][0]].dtype == np.float16 else np.inf
        values = np.where(np.abs(values) >= min(sky, end), np.inf, values)
    if name in VECTORS:
        values = np.where(np.isfinite(values).all(0), values, np.nan)
    rounded = np.float16 if stored[found.names[0][0]].dtype == np.float16 else np.float32  # as the file has it
    with np.errstate(over="ignore"):
        unknown = [np.float32(rounded(value)) for value in source.unknown if value != SKY]
    for value in unknown:
        values = np.where((values == value).all(0), np.nan, values)
    if (source.scale, source.offset) == ([1], [0]):
        return values
    with np.errstate(over="ignore"):  # what exceeds float32 becomes infinite: a miss, or a bad pixel
        return np.asarray(values * scale + offset, np.float32)


def step(stored: Stored, source: Source, found: Found) -> float:
    """Measure the steps in which a channel is stored in half floats: their median, decoded; 0 for other types.

    Values that are not finite do not count.
    """
    halves = [stored[name].ravel() for name in found.names[0] if stored[name].dtype == np.float16]
    sizes = np.abs(np.concatenate([np.empty(0, np.float16), *halves]))
    steps = np.spacing(sizes[sizes < HALF_MAX]).astype(np.float64)  # without NaN
    return float(np.median(steps) * max(map(abs, source.scale))) if steps.size else 0.0


def missing(
    path: Path, stored: Stored, name: str, source: Source, prefix: str = "", parts: Sequence[Part] = ()
) -> NteError:
    """Make the error for a channel that `find` did not find; it lists what the file has, its views among it."""
    count = len(CHANNELS[name].components)
    wanted = " ".join(source.layer) if source.layer not in ([], [_OWN]) else "components without a layer"
    have = sorted(stored)
    more = f" … ({len(have)} in all)" if len(have) > _LISTED else ""
    listed = ", ".join(have[:_LISTED]) + more
    hint = ""
    if count == 1 and any(len(_below(stored, layer)) > 1 for layer in _alternatives(source.layer, prefix)):
        hint = ", of which the map may name one by its full name"
    if name in ("color", "reference") and source.layer != [_OWN] and {"R", "G", "B"} <= set(stored):
        hint = f"; channels.{name}={_OWN} takes R, G and B"
    if not source.view and (views := [view for part in parts for view in part.views]):
        hint = f"; it has the views {', '.join(views)}: choose one with view=NAME"
    if reduced := [part.full(name) for part in parts for name in part.subsampled]:
        hint += f"; without a value for every pixel: {', '.join(reduced)}"
    needed = f"{count} components" if count > 1 else "1 component"
    below = f" with the prefix '{prefix}'" if prefix else ""
    return NteError(f"{path}: no {wanted}{below} for '{name}' ({needed}); the file has {listed}{hint}")


def _alternatives(layers: Sequence[str], prefix: str) -> list[str]:
    """The full names of all layers in a list of «A | B», besides that of no layer."""
    names = [name.strip() for layer in layers for name in layer.split(" | ")]
    return [f"{prefix}.{name}" if prefix else name for name in names if name != _OWN]


def _of_layers(stored: Stored, row: Channel, layer: Sequence[str], prefix: str) -> tuple[str, ...]:
    """Full names of a channel's components: listed one by one, or those of the first alternative of «A | B» found."""
    count = len(row.components)

    def full(name: str) -> str:
        return f"{prefix}.{name}" if prefix and name != _OWN else prefix or name

    if len(layer) == count and all(full(name) in stored for name in layer):
        return tuple(full(name) for name in layer)
    for name in layer[0].split(" | ") if len(layer) == 1 else ():
        if count == 1 and full(name.strip()) in stored:
            return (full(name.strip()),)
        if names := _components(stored, row, full(name.strip())):
            return names
    return ()


def _components(stored: Stored, row: Channel, layer: str) -> tuple[str, ...]:
    below = _below(stored, layer)
    count = len(row.components)
    if count == 1:
        direct = [full for component, full in below.items() if "." not in component]  # not those of a layer below it
        if len(direct) == 1:
            return tuple(direct)
        grey = [stored[below[c]] for c in "rgb" if c in below]
        if len(grey) == 3 and all(np.array_equal(grey[0], other, equal_nan=True) for other in grey[1:]):
            return (below["r"],)
    own = [c.lower() for c in row.components]
    for suffixes in sorted(_SUFFIXES.get(count, ()), key=lambda names: [*names] != own):
        if set(suffixes) <= set(below):
            return tuple(below[s] for s in suffixes)
    if row.kind in ("radiance", "reflectance") and "y" in below and not _CHROMA & set(below):
        return (below["y"],) * count  # a grey image
    return ()


def _below(stored: Stored, layer: str) -> dict[str, str]:
    """Component in lower case → full name, for one layer or for channels without a layer.

    A component that is there in both cases (R and r) is left out: nobody knows which one is meant.
    """
    start = 0 if layer == _OWN else len(layer) + 1
    full = [key for key in stored if ("." not in key if layer == _OWN else key.startswith(f"{layer}."))]
    count = Counter(key[start:].lower() for key in full)
    return {key[start:].lower(): key for key in full if count[key[start:].lower()] == 1}


def _common_layer(names: Sequence[str]) -> str:
    if len(names) == 1:
        return names[0]
    layers = {name.rpartition(".")[0] for name in names}
    return layers.pop() if len(layers) == 1 and layers != {""} else " ".join(names)
