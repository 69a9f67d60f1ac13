"""Places with one writer at a time: a folder, which is locked, or a file, whose hidden name tells who is at work."""

import glob
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from nte.errors import NteError
from nte.files import already_there, is_at_work, make_folder, sweep, temporary_name

_held: set[int] = set()  # descriptors of the folders that this process has locked


@contextmanager
def only_writer(folder: Path) -> Iterator[None]:
    """Make `folder` and lock it for this block: raises NteError if another process is inside such a block.

    Leftovers of killed processes in the folder are removed first. A new folder that is still empty at the end is
    removed. The system releases the lock when the process ends, and there is no lock file. Windows has no such locks:
    there nothing is refused.
    """
    was_there = folder.is_dir()
    make_folder(folder)
    descriptor = _locked(folder)
    _held.update(() if descriptor is None else (descriptor,))
    try:
        sweep(folder)
        yield
    finally:
        with suppress(OSError):
            if not was_there:
                folder.rmdir()  # only if it is empty
        if descriptor is not None:
            _held.discard(descriptor)
            os.close(descriptor)


def _close_inherited() -> None:
    """Close the parent's locks in a forked process: a worker would keep the folder locked after its parent's death."""
    for descriptor in _held:
        with suppress(OSError):
            os.close(descriptor)
    _held.clear()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_close_inherited)


@contextmanager
def only_writer_of(path: Path, force: bool) -> Iterator[None]:
    """Reserve the file `path` for this block, which makes it.

    All the work that ends in the file belongs in the block, so that it is not done in vain and does not overwrite
    what another process has written meanwhile. A hidden file beside `path` tells others who is at work. Raises NteError
    if `path` exists without `force`, if another process is making it, and if the folder cannot be written to.
    """
    if not path.name:
        raise NteError(f"'{path}' has no file's name: expected one")
    sweep(path.parent, path.name)
    was_there = path.parent.is_dir()
    make_folder(path.parent)
    mine = temporary_name(path)
    try:
        mine.touch()
    except OSError as error:
        raise NteError(f"{path}: cannot be written: {error.strerror}") from error
    try:
        refuse_other_writers(path, mine)
        if os.path.lexists(path) and not force:
            raise already_there(path)
        yield
    finally:
        with suppress(OSError):
            mine.unlink(missing_ok=True)
            if not was_there:
                path.parent.rmdir()  # only if it is empty


def refuse_other_writers(path: Path, mine: Path) -> None:
    """Raise NteError if a live process on this machine has a temporary name for `path` other than `mine`."""
    for other in path.parent.glob(f".{glob.escape(path.name)}.*.tmp"):
        if other != mine and is_at_work(other, path.name):
            raise NteError(f"{path}: another process is writing it: wait for it, or choose another name")


def _locked(folder: Path) -> int | None:
    """An open descriptor that holds the lock of a folder; None if the system or the file system has no locks."""
    try:
        import fcntl
    except ImportError:
        return None
    try:
        descriptor = os.open(folder, os.O_RDONLY)
    except OSError as error:
        raise NteError(f"{folder}: cannot be opened: {error.strerror}") from error
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        if not (folder.is_dir() and os.path.samestat(os.fstat(descriptor), folder.stat())):
            raise BlockingIOError  # another process has just removed or replaced the folder
    except BlockingIOError as error:
        os.close(descriptor)
        raise NteError(f"{folder}: another process is writing to it: wait for it, or choose another folder") from error
    except OSError:
        os.close(descriptor)
        return None
    return descriptor
