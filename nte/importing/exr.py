"""`nte import exr`: EXR sequences of any engine, described by a channel map."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from nte.errors import NteError
from nte.frames.channels import CHANNELS
from nte.frames.clip import Pixels
from nte.frames.exr import read_exr
from nte.importing.channel_map import Camera, ChannelMap, Vectors, load_cameras, load_channel_map
from nte.importing.convert import to_ours, with_motion
from nte.importing.files import numbered_files
from nte.importing.write import refuse_existing, write_imported

Layers = Mapping[str, Pixels]
_SUFFIXES = {1: ("",), 2: ("xy", "rg", "uv"), 3: ("rgb", "xyz")}  # of a layer's components, in their order


@dataclass(frozen=True)
class Imported:
    """A finished clip, and what is worth saying about how it came about."""

    folder: Path
    vectors: Vectors  # how `motion` was read
    map: Path | None = None  # the channel map, where there is one to correct
    called: Mapping[str, str] = field(default_factory=dict)  # channel → what its source is called there


def import_exr(source: Path, map_path: Path, out: Path, reference: Path | None = None, force: bool = False) -> Imported:
    """Import numbered EXR frames as the clip `out`; returns when the clip is whole.

    source, reference: a folder, a file or a glob pattern. The reference image is the `reference` of the map,
    or its `color`, in the files of `reference`. Raises NteError, with nothing left behind, for a faulty map,
    layers that are missing, sequences that do not match, and an `out` that exists (see refuse_existing).
    """
    refuse_existing(out, force)
    how = load_channel_map(map_path)
    files, references = matching_files(source, reference)
    cameras = load_cameras(map_path.parent / how.cameras, len(files)) if how.cameras else []
    of_reference = {"reference": how.channels.get("reference", how.channels["color"])} if reference else {}
    of_source = {name: names for name, names in how.channels.items() if name not in of_reference}

    def pick(path: Path, layers: Layers) -> dict[str, Pixels]:
        return {name: find(path, layers, name, names) for name, names in of_source.items()}

    def pick_reference(path: Path, layers: Layers) -> dict[str, Pixels]:
        return {name: find(path, layers, name, names) for name, names in of_reference.items()}

    frames = read_frames(files, references, pick, pick_reference, how, cameras)
    write_imported(out, frames, len(files), "OpenEXR files", cameras)
    return Imported(out, how.motion, map_path)


def matching_files(source: Path, reference: Path | None) -> tuple[list[Path], list[Path]]:
    """The frames of the noisy sequence and of its reference (empty without one), which have the same numbers."""
    files = numbered_files(source, ".exr")
    if reference is None:
        return list(files.values()), []
    references = numbered_files(reference, ".exr")
    if list(files) != list(references):
        first, second = (f"{min(f)} to {max(f)}" for f in (files, references))
        raise NteError(
            f"{reference}: has {len(references)} frames ({second}), {source} has {len(files)} ({first}): "
            "expected the same frame numbers"
        )
    return list(files.values()), list(references.values())


def read_frames(
    files: Sequence[Path],
    references: Sequence[Path],
    pick: Callable[[Path, Layers], dict[str, Pixels]],
    pick_reference: Callable[[Path, Layers], dict[str, Pixels]],
    how: ChannelMap,
    cameras: Sequence[Camera] = (),
) -> Iterator[dict[str, Pixels]]:
    """The channels of every frame in nte's conventions; `pick` takes a producer's channels from a file's layers.

    Raises NteError for a size that differs from the first frame's.
    """

    def read() -> Iterator[dict[str, Pixels]]:
        first: tuple[int, ...] | None = None
        for index, path in enumerate(files):
            given = pick(path, layers := read_exr(path))
            sizes = {path: next(iter(layers.values())).shape}
            if references:
                other = read_exr(references[index])
                given |= pick_reference(references[index], other)
                sizes[references[index]] = next(iter(other.values())).shape
            for name, size in sizes.items():
                first = first or size
                if size != first:
                    found, expected = f"{size[1]}x{size[0]}", f"{first[1]}x{first[0]}"
                    raise NteError(f"{name}: is {found}, expected {expected} like {files[0]}")
            yield to_ours(given, how, cameras[index] if cameras else None)

    return with_motion(read())


def find(path: Path, layers: Layers, name: str, names: Sequence[str]) -> Pixels:
    """Channel `name` (C, H, W) from a file's layers: its components by name, or one layer that holds them.

    Raises NteError that lists what the file has.
    """
    count = len(CHANNELS[name].components)
    if len(names) == count and all(n in layers for n in names):
        return np.stack([layers[n] for n in names])
    if len(names) == 1:
        below = {key[len(names[0]) + 1 :].lower(): key for key in layers if key.startswith(f"{names[0]}.")}
        if count == 1 and len(below) == 1:
            return np.stack([layers[key] for key in below.values()])
        for suffixes in _SUFFIXES.get(count, ()):
            if suffixes and set(suffixes) <= set(below):
                return np.stack([layers[below[s]] for s in suffixes])
    have = ", ".join(sorted(layers))
    raise NteError(f"{path}: no {' '.join(names)} for '{name}' ({count} components); the file has {have}")
