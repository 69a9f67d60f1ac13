"""Denoiser of files: reads a clip or loose frames, writes linear OpenEXR files and keeps their other layers."""

import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from nte.denoiser import Denoiser, Session, require_channels
from nte.errors import NteError, needs_extra
from nte.files import is_file_or_lost, only_writer, refuse_to_replace, remove
from nte.frames.channels import CHANNELS
from nte.frames.clip import Clip, Pixels, frame_path, read_frame
from nte.frames.clip_info import write_clip_info
from nte.frames.exr import read_parts
from nte.frames.exr_copy import Planes, copy_exr
from nte.frames.frame import About, Frame
from nte.frames.numbering import by_number
from nte.frames.scalars import sequence_scalars
from nte.frames.show import show, write_png
from nte.overlap import ahead, behind
from nte.progress import Progress
from nte.unfinished import begin, finish, is_unfinished


class _Source(NamedTuple):
    """The frames to denoise, the file of each, and the layers that a denoised image replaces there."""

    files: Sequence[Path]
    frames: Iterable[Frame]
    layers: Callable[[int, Pixels], Planes]  # frame i and its denoised image (C, H, W) → the planes for copy_exr
    clip: Clip | None = None
    notes: Callable[[], Iterable[str]] = tuple  # notes for the user, complete when all frames have been read


class _Denoised(NamedTuple):
    """A denoised frame of a sequence: its number, its pixels (C, H, W), and the exposure that they were shown with."""

    number: int
    pixels: Pixels
    exposure: float


def denoise_files(
    sources: Sequence[Path], denoiser: Denoiser, out: Path, exposure: float | None = None, png: bool = False,
    force: bool = False, map_name: str | None = None, overrides: Sequence[str] = (),
    say: Callable[[str], None] = print, spec: str | None = None,
) -> list[Path]:  # fmt: skip
    """Denoise a clip, or frames in the order of their numbers, into the folder `out`; return the frames' new files.

    sources: a clip, a folder of frames, or the files of the frames. map_name: the channel map for frames of another
    renderer, a file or the name of one that ships; None takes the one that fits. overrides: `key=value` for the map. A
    frame keeps its name, attributes and layers; only the noisy image is replaced by the denoised one. A clip stays a
    clip. exposure: linear factor for the sequence; None takes the clip's own, or estimates it from the first frame.
    png: write a tonemapped picture beside each frame as well. say: called with each note on how foreign files were
    read. spec: what the denoiser was loaded from; where the same call was killed, it begins again and replaces the
    files that it had written. Raises NteError for input that does not fit the denoiser, and for all other files that
    exist without `force`.
    """
    if exposure is not None and not 0 < exposure < float("inf"):
        raise NteError(f"exposure is {exposure}, expected a positive number")
    source = _open(sources, denoiser.target, map_name, overrides)
    written = [out / path.name for path in source.files]
    command = {
        "denoise": sources, "spec": spec, "exposure": exposure, "png": png, "map": map_name, "set": list(overrides)
    }  # fmt: skip
    if source.clip:
        require_channels(denoiser, source.clip.channels, source.clip.folder)

    done: _Denoised | None = None
    with only_writer(out), Progress("denoise", len(written), "frame") as progress:
        force = force or (spec is not None and is_unfinished(out, command))
        _refuse_to_overwrite(out, written, source.files, png, force)

        def write(image: _Denoised) -> _Denoised:
            if image.number == 0:
                begin(out, command)
                remove(out / "clip.json")  # until its frames are all there
            _write(image, source, written[image.number], denoiser.target, png)
            return image

        for done in behind(write, _denoised(ahead(source.frames), Session(denoiser), exposure)):
            progress.advance(1)
            progress.say(written[done.number].name)
        if source.clip and done:
            write_clip_info(out, {**source.clip.info, "seeds": 1, "exposure": done.exposure})
        finish(out)
    for note in source.notes():
        say(note)
    return written


def _denoised(frames: Iterable[Frame], session: Session, exposure: float | None) -> Iterator[_Denoised]:
    """Denoise the frames of a sequence in their order, all with one exposure: the given one, or that of the first."""
    scale = None if exposure is None else np.array([exposure], np.float32)
    for index, frame in enumerate(frames):
        scale = sequence_scalars(frame)[0] if scale is None else scale
        yield _Denoised(index, session.denoise(replace(frame, exposure=scale))[0], float(scale[0]))


def _write(image: _Denoised, source: _Source, out: Path, target: str, png: bool) -> None:
    """Write a frame's file with the denoised image in it, and the picture beside it."""
    dark_counts = CHANNELS[target].kind == "radiance"
    copy_exr(source.files[image.number], out, source.layers(image.number, image.pixels), dark_counts)
    if png:
        write_png(out.with_suffix(".png"), show(target, image.pixels, image.exposure).pixels)


def _open(sources: Sequence[Path], target: str, map_name: str | None, overrides: Sequence[str]) -> _Source:
    """Find out what the sources are: a clip, frames with nte's channels, or frames of another renderer."""

    def ours(index: int, image: Pixels) -> Planes:
        return {f"{target}.{c}": plane for c, plane in zip(CHANNELS[target].components, image, strict=True)}

    folder = sources[0] if len(sources) == 1 and sources[0].is_dir() else None
    mapped = map_name is not None or bool(overrides)
    if folder and not mapped and ((folder / "clip.json").exists() or _has(frame_path(folder, 0), target)):
        clip = Clip(folder)
        return _Source([frame_path(folder, i) for i in range(len(clip))], clip, ours, clip)
    files = _frames_in(folder) if folder else list(sources)
    if not files:
        raise NteError(f"{folder}: has no clip.json and no .exr frames: expected a clip or a folder of frames")
    if not mapped:
        files = _in_order(files)
        if not files[0].exists() or _has(files[0], target):
            return _Source(files, _with_forward(map(read_frame, files), files), ours)
    if target != "color":
        raise NteError(
            f"{files[0]}: has no '{target}', which this denoiser gives; in others' frames it has to be color"
        )
    return _foreign(folder or files, files[0], map_name, overrides)


def _foreign(source: Path | Sequence[Path], first: Path, map_name: str | None, overrides: Sequence[str]) -> _Source:
    """Open frames of another renderer. first: one of the files, to recognise the renderer by.

    A channel map may name several files for a frame, if `source` is a folder.
    """
    try:
        from nte.importing.recognise import recognise
        from nte.importing.sequence import ForeignSequence
    except ImportError as error:
        raise needs_extra("import", "reading frames of another renderer", error) from error
    sequence = ForeignSequence(source, map_name or recognise(first), overrides=overrides)

    def notes() -> Iterable[str]:
        left_out = [f"{name} is left out: {lacks}" for name, lacks in sequence.left_out.items()]
        return [f"read as {sequence.how.producer} (--map {sequence.map.stem})", *left_out, *sequence.notes()]

    frames = _with_forward(sequence.frames(), sequence.files, sequence.about)
    return _Source(sequence.files, frames, sequence.replacing, notes=notes)


def _has(path: Path, target: str) -> bool:
    """Tell whether a frame exists and has the channel `target` under nte's name."""
    names = {part.full(channel) for part in read_parts(path) for channel in part.layers} if path.exists() else set()
    return names >= {f"{target}.{c}" for c in CHANNELS[target].components}


def _frames_in(folder: Path) -> list[Path]:
    """The EXR files of a folder; hidden ones, which systems and killed processes leave behind, do not count."""
    return sorted(path for path in folder.glob("*.[eE][xX][rR]") if is_file_or_lost(path) and path.name[0] != ".")


def _refuse_to_overwrite(out: Path, written: Sequence[Path], sources: Sequence[Path], png: bool, force: bool) -> None:
    """Raise NteError if a file would be lost: one that exists, a noisy frame itself, or one of two with one name."""
    if out.resolve() in {source.parent.resolve() for source in sources}:
        raise NteError(f"{out}: holds the noisy frames themselves: choose another folder")
    twice = [path for path, count in Counter(written).items() if count > 1]
    if twice:
        raise NteError(f"{twice[0].name}: two frames have this name: denoise them one after the other")
    pictures = [path.with_suffix(".png") for path in written] if png else []
    refuse_to_replace((*written, *pictures, out / "clip.json"), force)


def _with_forward(
    stored: Iterable[Mapping[str, Pixels]],
    paths: Sequence[Path],
    about: Callable[[int], About] = lambda index: {},
) -> Iterator[Frame]:
    """Make frames from stored channels (C, H, W).

    The forward motion of a frame becomes the previous_forward_motion of the next one. about: index → the frame's
    scalars and camera. Raises NteError for a frame without channels or of another size.
    """
    forward, size = None, None
    for index, (path, read) in enumerate(zip(paths, stored, strict=True)):
        if not read:
            raise NteError(f"{path}: has no channel of ours, such as color.R, albedo.R or depth.Z")
        channels = {name: values[None] for name, values in read.items()}
        shape = next(iter(read.values())).shape[1:]
        if size not in (None, shape):
            raise NteError(f"{path}: {shape[1]}x{shape[0]} after {size[1]}x{size[0]}: frames must have one size")
        size = shape
        if "forward_motion" in channels:
            unknown = np.full_like(channels["forward_motion"], np.nan)
            channels["previous_forward_motion"] = unknown if forward is None else forward
            forward = channels["forward_motion"]
        yield Frame(channels, index, **about(index))


def _in_order(sources: Sequence[Path]) -> list[Path]:
    """Sort files by the numbers in their names, without gaps; keep the given order if no name has a number."""
    numbered = any(re.search(r"\d", path.stem) for path in sources)
    return list(by_number(sources).values()) if numbered else list(sources)
