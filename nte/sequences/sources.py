"""What is denoised: a clip, frames with nte's channels, or frames of another renderer as they are."""

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from nte.errors import NteError, needs_extra
from nte.files import is_file_or_lost
from nte.frames.channels import CHANNELS
from nte.frames.clip import Clip, Pixels, read_frame
from nte.frames.clip_files import frame_path
from nte.frames.exr import read_parts
from nte.frames.exr_copy import Planes
from nte.frames.frame import About, Frame
from nte.frames.guides import are_clean
from nte.frames.numbering import by_number
from nte.frames.sample import FRAMES

WARM_UP = 32  # frames before a range, from which its first frame has nearly the history that it has in the whole


class Source(NamedTuple):
    """The frames to denoise, the file of each, and the layers that a denoised image replaces there."""

    files: Sequence[Path]
    frames: Iterable[Frame]
    layers: Callable[[int, Pixels], Planes]  # frame i and its denoised image (C, H, W) → the planes for copy_exr
    clip: Clip | None = None
    view: str = "nte"  # the view transform of pictures, if none is chosen
    notes: Callable[[], Iterable[str]] = tuple  # notes for the user, complete when all frames have been read
    warm_up: int = 0  # how many of the first frames are there for the history of the others alone
    others: Sequence[Path] = ()  # further files that are read, where a channel map names some


Part = Callable[[Sequence[int]], slice]  # the frame numbers of a sequence → the frames of it that are read


def open_source(
    sources: Sequence[Path],
    target: str,
    map_name: str | None,
    overrides: Sequence[str],
    wanted: range | None = None,
    ahead: bool = False,
) -> Source:
    """Find out what the sources are: a clip, frames with nte's channels, or frames of another renderer.

    wanted: numbers of the frames to denoise, in their names, or indices of a clip's; None for all. ahead: the frames
    have one more than the files have, if there is one after the range. Raises NteError for a range that is not wholly
    there.
    """
    if wanted is None:
        return _open(sources, target, map_name, overrides, lambda numbers: slice(None))

    warm_up = 0

    def part(numbers: Sequence[int]) -> slice:
        nonlocal warm_up
        first, end = wanted.start - numbers[0], wanted.stop - numbers[0]
        if not 0 <= first < end <= len(numbers):
            asked = f"frames {wanted.start} to {wanted.stop - 1}"
            raise NteError(f"{asked}: the sequence has {numbers[0]} to {numbers[-1]}: expected a range in it")
        warm_up = min(first, WARM_UP)
        return slice(first - warm_up, end + ahead)

    source = _open(sources, target, map_name, overrides, part)
    return source._replace(files=source.files[: warm_up + len(wanted)], warm_up=warm_up)


def first_frame(sources: Sequence[Path], target: str, map_name: str | None, overrides: Sequence[str]) -> Frame:
    """Read the first frame of the whole sequence, from which its exposure is known."""
    return next(iter(_open(sources, target, map_name, overrides, lambda numbers: slice(0, 1)).frames))


def guides_are_clean(
    sources: Sequence[Path], target: str, map_name: str | None, overrides: Sequence[str]
) -> bool | None:
    """Tell whether albedo and normals are antialiased and noise-free, as at most four frames of the sequence show.

    None if there are neither.
    """

    def some(numbers: Sequence[int]) -> slice:
        return slice(0, None, -(-len(numbers) // FRAMES))

    return are_clean(_open(sources, target, map_name, overrides, some).frames)


def _open(sources: Sequence[Path], target: str, map_name: str | None, overrides: Sequence[str], part: Part) -> Source:

    def ours(index: int, image: Pixels) -> Planes:
        return {f"{target}.{c}": plane for c, plane in zip(CHANNELS[target].components, image, strict=True)}

    folder = sources[0] if len(sources) == 1 and sources[0].is_dir() else None
    mapped = map_name is not None or bool(overrides)
    if folder and not mapped and ((folder / "clip.json").exists() or target in _own_channels(frame_path(folder, 0))):
        clip = Clip(folder)
        indices = range(len(clip))[part(range(len(clip)))]
        return Source([frame_path(folder, i) for i in indices], map(clip.frame, indices), ours, clip)
    if (inner := next((path for path in sources if path.is_dir()), None)) and not folder:
        raise NteError(f"{inner}: is a folder beside others: expected one folder, or the files of one sequence")
    files = _frames_in(folder) if folder else list(sources)
    if not files and not (folder and map_name):  # whose map may name files in folders below
        raise NteError(f"{folder}: has no clip.json and no .exr frames: expected a clip or a folder of frames")
    if not mapped:
        numbered = _in_order(files)
        files = list(numbered.values())
        found = _own_channels(files[0])
        if not files[0].exists() or target in found:
            files = files[part(list(numbered))]
            note = f"read as nte's own channels: {', '.join(found)}; if they are another renderer's, give --map"
            return Source(files, _with_forward(map(read_frame, files), files), ours, notes=lambda: [note])
    first = files[0] if files else sources[0]
    if target != "color":
        raise NteError(f"{first}: has no '{target}', which this denoiser gives; in others' frames it has to be color")
    if map_name is None and target in _own_channels(first):
        what = f"{', '.join(overrides)} changes a channel map, but these are nte's own channels"
        raise NteError(f"{first}: {what}: leave --set out, or give --map")
    return _foreign(folder or files, first, map_name, overrides, part)


def _foreign(
    source: Path | Sequence[Path], first: Path, map_name: str | None, overrides: Sequence[str], part: Part
) -> Source:
    """Open frames of another renderer. first: one of the files, to recognise the renderer by.

    A channel map may name several files for a frame, if `source` is a folder.
    """
    try:
        from nte.importing.recognise import recognise
        from nte.importing.sequence import ForeignSequence
    except ImportError as error:
        raise needs_extra("import", "reading frames of another renderer", error) from error
    sequence = ForeignSequence(source, map_name or recognise(first), overrides=overrides, choose_frames=part)

    def notes() -> Iterable[str]:
        left_out = [f"{name} is left out: {lacks}" for name, lacks in sequence.left_out.items()]
        return [f"read as {sequence.how.producer} (--map {sequence.map.stem})", *left_out, *sequence.notes()]

    frames = _with_forward(sequence.frames(), sequence.files, sequence.about)
    others = [path for channel in sequence.inputs for path in channel.files]
    return Source(sequence.files, frames, sequence.replacing, view="standard", notes=notes, others=others)


def _own_channels(path: Path) -> list[str]:
    """List the channels that a frame has under nte's names; none if there is no such file."""
    names = {part.full(channel) for part in read_parts(path) for channel in part.layers} if path.exists() else set()
    return [name for name, row in CHANNELS.items() if {f"{name}.{c}" for c in row.components} <= names]


def _frames_in(folder: Path) -> list[Path]:
    """The EXR files of a folder; hidden ones, which systems and killed processes leave behind, do not count."""
    return sorted(path for path in folder.glob("*.[eE][xX][rR]") if is_file_or_lost(path) and path.name[0] != ".")


def _with_forward(
    stored: Iterable[Mapping[str, Pixels]],
    paths: Sequence[Path],
    about: Callable[[int], About] = lambda index: {},
) -> Iterator[Frame]:
    """Make frames from stored channels (C, H, W).

    The forward motion of a frame becomes the previous_forward_motion of the next one. about: index → the frame's
    scalars and camera. Raises NteError for a frame without channels, of another size or with other channels.
    """
    forward, size, names = None, None, list[str]()
    for index, (path, read) in enumerate(zip(paths, stored, strict=True)):
        if not read:
            raise NteError(f"{path}: has no channel of ours, such as color.R, albedo.R or depth.Z")
        channels = {name: values[None] for name, values in read.items()}
        shape = next(iter(read.values())).shape[1:]
        if size not in (None, shape):
            raise NteError(f"{path}: {shape[1]}x{shape[0]} after {size[1]}x{size[0]}: frames must have one size")
        size = shape
        names = names or sorted(read)
        if differing := sorted({*read} ^ {*names}):
            which = "lacks" if differing[0] in names else "has"
            what = f"{which} '{differing[0]}', unlike {paths[0].name}"
            raise NteError(f"{path}: {what}: expected the same channels in each frame")
        if "forward_motion" in channels:
            unknown = np.full_like(channels["forward_motion"], np.nan)
            channels["previous_forward_motion"] = unknown if forward is None else forward
            forward = channels["forward_motion"]
        yield Frame(channels, index, **about(index))


def _in_order(sources: Sequence[Path]) -> dict[int, Path]:
    """Sort files by the numbers in their names, without gaps; keep and count the given order if none has a number."""
    numbered = any(re.search(r"\d", path.stem) for path in sources)
    return by_number(sources) if numbered else dict(enumerate(sources))
