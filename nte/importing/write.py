"""Writer of imported clips: a clip appears under its name only when it is finished."""

import os
import shutil
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from nte.errors import NteError
from nte.files import already_there, make_folder, sweep, temporary_name
from nte.frames.clip import Clip, Pixels, write_frame
from nte.frames.clip_files import frame_path, is_clip_file
from nte.frames.clip_info import write_clip_info
from nte.frames.guides import guides_are_clean
from nte.importing.cameras import Camera
from nte.progress import Progress
from nte.version import __version__
from nte.writers import only_writer, refuse_other_writers


def refuse_existing(out: Path, force: bool) -> None:
    """Raise NteError if `out` exists, unless it is an empty folder or, with `force`, a clip and nothing else.

    Also if it is the current folder, since a clip takes the place of its folder.
    """
    if out.resolve() == Path.cwd():
        raise NteError(f"{out}: is the current folder, which the clip would replace: expected the name of a new folder")
    if not out.exists() or (out.is_dir() and not any(out.iterdir())):
        return
    if not force:
        raise already_there(out, remedy="replace the clip")
    try:
        Clip(out)
    except NteError as error:
        raise NteError(f"{out}: is not a clip, so --force does not replace it: {error}") from error
    files = (path.relative_to(out).as_posix() for path in out.rglob("*") if path.is_symlink() or not path.is_dir())
    if others := sorted(name for name in files if not is_clip_file(name)):
        raise NteError(f"{out}: has '{others[0]}', which is no part of a clip and would be lost: move it elsewhere")


def write_imported(
    out: Path,
    frames: Iterable[Mapping[str, Pixels]],
    count: int,
    generator: str,
    cameras: Sequence[Camera] = (),
    force: bool = False,
    **info: Any,
) -> None:
    """Write `count` frames of channels (C, H, W) as the clip `out`; `force` lets it replace what is there.

    Everything goes into a hidden folder beside `out`, which is renamed at the end and removed on any error, so `out`
    is a whole clip, or empty and locked. clip.json gets generator, info, cameras, and whether albedo and normal are
    free of noise, as far as the pixels tell. Raises NteError if the disk is full, if the folder cannot be written to,
    if frames differ in their channels, and if another process writes to the same place.
    """
    make_folder(out.parent)  # or «missing/../clip» would be no name of the clip, once it is there
    out = out.resolve()
    sweep(out.parent, out.name)
    working = temporary_name(out)
    try:
        with only_writer(out), Progress("import", count, "frame") as progress:
            make_folder(working)
            refuse_other_writers(out, working)
            refuse_existing(out, force)
            height = width = 0
            names: list[str] = []
            for index, channels in enumerate(frames):
                names = names or sorted(channels)
                if sorted(channels) != names:
                    has, had = ", ".join(sorted(channels)), ", ".join(names)
                    raise NteError(f"{out}: frame {index} has {has}, the first one {had}: expected the same in each")
                height, width = channels["color"].shape[1:]
                write_frame(frame_path(working, index), channels)
                progress.advance(1)
            progress.say(out.name)
            if cameras:
                info["cameras"] = [{key: matrix.tolist() for key, matrix in c._asdict().items()} for c in cameras]
            origin = {"generator": generator, "imported_by": f"nte {__version__}"}
            about = {"width": width, "height": height, "frames": count, "origin": origin, **info}
            write_clip_info(working, about)
            write_clip_info(working, {**about, "clean_guides": guides_are_clean(Clip(working))})
            refuse_existing(out, force)  # once more: not every program looks at the lock
            _put_in_place(working, out)
    except OSError as error:
        raise NteError(f"{out}: cannot be written: {error.strerror or error}") from error
    finally:
        shutil.rmtree(working, ignore_errors=True)


def _put_in_place(working: Path, out: Path) -> None:
    """Rename `working` to `out`, which is there; an old clip is removed only now."""
    old = temporary_name(out)
    if any(out.iterdir()):
        out.rename(old)
    elif os.name == "nt":  # elsewhere a folder's new name may be that of an empty one
        out.rmdir()
    working.rename(out)
    shutil.rmtree(old, ignore_errors=True)
