"""Denoiser of files: linear OpenEXR files that keep their other layers, with pictures and a video where wanted."""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np

from nte.denoiser import Denoiser, require_channels
from nte.errors import NteError
from nte.files import refuse_to_replace, remove
from nte.frames.ahead import NEXT, with_next
from nte.frames.channels import CHANNELS, GUIDES
from nte.frames.clip_info import write_clip_info
from nte.frames.exr_copy import copy_exr
from nte.frames.frame import About, Frame
from nte.frames.scalars import given_exposure, known_scalars, sequence_scalars
from nte.overlap import ahead, behind
from nte.progress import Progress
from nte.sequences.pictures import Denoised, Pictures, PictureSettings
from nte.sequences.sources import first_frame, guides_are_clean, open_source
from nte.session import Session
from nte.unfinished import begin, finish, is_unfinished
from nte.writers import only_writer


def denoise_files(
    sources: Sequence[Path], denoiser: Denoiser, out: Path, exposure: float | None = None,
    pictures: PictureSettings | None = None, force: bool = False, map_name: str | None = None,
    overrides: Sequence[str] = (), say: Callable[[str], None] = print, spec: str | None = None,
    wanted: range | None = None,
) -> list[Path]:  # fmt: skip
    """Denoise a clip, or frames in the order of their numbers, into the folder `out`; return the frames' new files.

    sources: a clip, a folder of frames, or the files of the frames. map_name: the channel map for frames of another
    renderer, a file or the name of one that ships; None takes the one that fits. overrides: `key=value` for the map. A
    frame keeps its name, attributes and layers; only the noisy image is replaced by the denoised one. A clip stays a
    clip. Where it does not say whether its guides are clean, four of its frames tell. exposure: linear factor for the
    sequence; None takes the clip's own, or estimates it from the first frame. pictures: what else is written, to look
    at; None for nothing. say: called with each note on how foreign files were read. spec: what the denoiser was loaded
    from; where the same call was killed, it begins again and replaces the files that it had written. wanted: numbers of
    the frames to denoise, in their names (of a clip: their indices), and then no clip.json is written or touched; up to
    WARM_UP frames before them are denoised too, for their history, and not written. The next frame is read and the last
    one written while one is denoised. Raises NteError for input that does not fit the denoiser, and for all other files
    that exist without `force`.
    """
    if exposure is not None and not 0 < exposure < float("inf"):
        raise NteError(f"exposure is {exposure}, expected a positive number")
    source = open_source(
        sources, denoiser.target, map_name, overrides, wanted, ahead=not NEXT.keys().isdisjoint(denoiser.optional)
    )
    files = source.files[source.warm_up :]
    written = [out / path.name for path in files]
    pictures = pictures or PictureSettings()
    drawn = Pictures(pictures, denoiser.target, written, source.view)
    command = {
        "denoise": sources, "spec": spec, "exposure": exposure, "map": map_name, "set": list(overrides),
        "pictures": list(drawn.files), "view": drawn.name, "fps": pictures.fps,
        "frames": repr(wanted),
    }  # fmt: skip
    if source.clip:
        require_channels(denoiser, source.clip.channels, source.clip.folder)
    dark_counts = CHANNELS[denoiser.target].kind == "radiance"
    done: Denoised | None = None
    with only_writer(out), Progress("denoise", len(written), "frame") as progress:
        force = force or (spec is not None and is_unfinished(out, command))
        info = [] if wanted else [out / "clip.json"]  # some frames of a denoised clip may be replaced, and it stays one
        _refuse_to_overwrite(out, [*written, *drawn.files, *info], [*files, *source.others], force)

        def write(image: Denoised) -> Denoised:
            number = image.number
            if number == 0:
                begin(out, command)
                for path in info:
                    remove(path)  # until its frames are all there
            planes = source.layers(source.warm_up + number, image.pixels)
            copy_exr(files[number], written[number], planes, dark_counts)
            drawn.write(image)
            return image

        # A range is denoised with the exposure and the scale of depth that the whole sequence has.
        first = first_frame(sources, denoiser.target, map_name, overrides) if wanted else None
        trusts = bool(set(GUIDES) & {*denoiser.needs, *denoiser.optional})
        unknown = source.clip is None or source.clip.clean_guides is None
        # With guides that it cannot trust, Open Image Denoise denoises each of them first, for twice the time.
        clean = guides_are_clean(sources, denoiser.target, map_name, overrides) if trusts and unknown else None
        frames = islice(with_next(ahead(source.frames), denoiser.optional), len(source.files))
        images = _denoised(frames, Session(denoiser), exposure, source.warm_up, first, clean)
        with drawn.videos():
            for done in behind(write, images):
                progress.advance(1)
                progress.say(written[done.number].name)
        if source.clip and done and info:
            write_clip_info(out, {**source.clip.info, "seeds": 1, "exposure": done.exposure})
        finish(out)
    for note in source.notes():
        say(note)
    if clean is False:
        say("albedo or normal is noisy or aliased: where Open Image Denoise is used, it denoises both first")
    return written


def _denoised(
    frames: Iterable[Frame], session: Session, exposure: float | None, warm_up: int, first: Frame | None,
    clean: bool | None,
) -> Iterator[Denoised]:  # fmt: skip
    """Denoise the frames of a sequence in their order, all with one exposure: the given one, or that of the first.

    warm_up: how many are denoised for the history of those after them alone. first: the first frame of the sequence, if
    these begin later; its scale of depth counts, too. clean: whether guides are clean, None for what the frames say.
    """
    scale = None if exposure is None else np.array([exposure], np.float32)
    stated = scale is not None
    about: About = {} if clean is None else {"clean_guides": clean}
    if first is not None:
        depth_scale = known_scalars(first if scale is None else replace(first, exposure=scale))[1]
        about |= {} if np.isnan(depth_scale).any() else {"depth_scale": depth_scale}
    for number, frame in enumerate(frames, -warm_up):
        if scale is None:
            told = frame if first is None else first
            stated, scale = given_exposure(told) is not None, sequence_scalars(told)[0]
        image = session.denoise(replace(frame, exposure=scale, **about))[0]
        if number >= 0:
            yield Denoised(number, frame[session.denoiser.target][0], image, float(scale[0]), stated)


def _refuse_to_overwrite(out: Path, written: Sequence[Path], sources: Sequence[Path], force: bool) -> None:
    """Raise NteError if a file would be lost: one that exists, a noisy frame itself, or one of two with one name."""
    if out.resolve() in {place for source in sources for place in (source.parent.resolve(), source.resolve().parent)}:
        raise NteError(f"{out}: holds the noisy frames themselves: choose another folder")
    twice = [path for path, count in Counter(path.resolve() for path in written).items() if count > 1]
    if twice:
        raise NteError(f"{twice[0].name}: two files would have this name: two frames, or pictures: choose others")
    refuse_to_replace(written, force)
