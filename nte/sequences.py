"""Denoising files: a clip or loose frames in, linear OpenEXR out, the other layers kept."""

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from nte.denoiser import Denoiser, Session, check_needs
from nte.errors import NteError
from nte.files import only_writer
from nte.frames.clip import Clip, as_layers, frame_path, read_frame, write_clip_info
from nte.frames.exr import read_layers, write_exr
from nte.frames.frame import Frame
from nte.frames.numbering import by_number
from nte.frames.scalars import sequence_scalars
from nte.frames.show import show, write_png
from nte.progress import Progress


def denoise_files(
    sources: Sequence[Path], denoiser: Denoiser, out: Path, exposure: float | None = None, png: bool = False,
    force: bool = False,
) -> list[Path]:  # fmt: skip
    """Denoise a clip, or frames in the order of their numbers, into the folder `out`; returns what was written.

    A frame keeps its name and its layers; only the denoiser's target is replaced by the denoised image. A
    clip stays a clip. exposure: linear factor for the sequence (None: the clip's own, or estimated from the
    first frame). png: a tonemapped picture beside each frame. Raises NteError for input that does not fit
    and for files that exist, unless `force`.
    """
    if exposure is not None and not 0 < exposure < float("inf"):
        raise NteError(f"exposure is {exposure}, expected a positive number")
    clip = Clip(sources[0]) if len(sources) == 1 and sources[0].is_dir() else None
    paths = [frame_path(clip.folder, i) for i in range(len(clip))] if clip else _in_order(sources)
    written = [out / path.name for path in paths]
    _refuse_to_overwrite(out, written, paths, png, force)
    if clip:
        check_needs(denoiser, clip.channels, clip.folder)

    session = Session(denoiser)
    scale = None if exposure is None else np.array([exposure], np.float32)
    with only_writer(out), Progress("denoise", len(paths), "frame") as progress:
        for path, source, frame in zip(written, paths, clip or _loose_frames(paths), strict=True):
            scale = sequence_scalars(frame)[0] if scale is None else scale
            image = session.denoise(replace(frame, exposure=scale))[0]
            if path == written[0]:
                (out / "clip.json").unlink(missing_ok=True)  # until its frames are all there
            write_exr(path, read_layers(source) | as_layers({denoiser.target: image}))
            if png:
                write_png(path.with_suffix(".png"), show(denoiser.target, image, float(scale[0])).pixels)
            progress.advance(1)
        if clip and scale is not None:
            write_clip_info(out, {**clip.info, "seeds": 1, "exposure": float(scale[0])})
    return written


def _refuse_to_overwrite(
    out: Path, written: Sequence[Path], sources: Sequence[Path], png: bool, force: bool
) -> None:  # fmt: skip
    """Raise NteError where a file would be lost: one that exists, the noisy frame itself, or one of two alike."""
    if out.resolve() in {source.parent.resolve() for source in sources}:
        raise NteError(f"{out}: holds the noisy frames themselves: choose another folder")
    twice = [path for path, count in Counter(written).items() if count > 1]
    if twice:
        raise NteError(f"{twice[0].name}: two frames have this name: denoise them one after the other")
    pictures = [path.with_suffix(".png") for path in written] if png else []
    for path in (*written, *pictures, out / "clip.json"):
        if path.exists() and not force:
            raise NteError(f"{path}: exists: choose another folder, or overwrite it with --force")


def _loose_frames(paths: Sequence[Path]) -> Iterator[Frame]:
    """Frames of files that are no clip; the forward motion of a file is handed over with the next one."""
    forward, size = None, None
    for index, path in enumerate(paths):
        stored = read_frame(path)
        if not stored:
            raise NteError(f"{path}: has no channel of ours (see datasets/README.md), such as color.R")
        channels = {name: values[None] for name, values in stored.items()}
        shape = next(iter(stored.values())).shape[1:]
        if size not in (None, shape):
            raise NteError(f"{path}: {shape[1]}x{shape[0]} after {size[1]}x{size[0]}: frames must have one size")
        size = shape
        if "forward_motion" in channels:
            unknown = np.full_like(channels["forward_motion"], np.nan)
            channels["previous_forward_motion"] = unknown if forward is None else forward
            forward = channels["forward_motion"]
        yield Frame(channels, index)


def _in_order(sources: Sequence[Path]) -> list[Path]:
    """Files by the numbers in their names, without gaps; as they are given where one has none."""
    numbered = all(re.search(r"\d", path.stem) for path in sources)
    return list(by_number(sources).values()) if numbered else list(sources)
