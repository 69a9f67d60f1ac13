"""Files that are whole or absent, folders with one writer, and the removal of what killed processes leave behind."""

import glob
import os
import re
import secrets
import shutil
import socket
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from hashlib import sha256
from pathlib import Path

from nte.errors import NteError

_OWNER = re.compile(r"\.(?P<host>[0-9a-f]{8})_(?P<process>\d+)_(?P<birth>[0-9a-f]{8})_[0-9a-f]{8}\.tmp$")
_UNKNOWN, _ENDED = "0" * 8, "f" * 8

_held: set[int] = set()  # descriptors of the folders that this process has locked


def _digest(text: str) -> str:
    return sha256(text.encode()).hexdigest()[:8]


def _machine() -> str:
    """Digest of what the numbers of processes belong to: a machine, or one of the containers of that name on it."""
    try:
        numbers = os.readlink("/proc/self/ns/pid")
    except OSError:
        numbers = ""
    return _digest(f"{socket.gethostname()} {numbers}")


_HERE = _machine()


def _birth(process: int) -> str:
    """Digest of when a process has begun, since its number is given again, at the latest after a restart.

    _UNKNOWN where the system does not tell, and _ENDED for a process that has ended and is kept in the system's list
    until its parent asks for its status.
    """
    try:
        boot = Path("/proc/sys/kernel/random/boot_id").read_text()
        state, *others = Path(f"/proc/{process}/stat").read_text(errors="replace").rpartition(")")[2].split()
        return _ENDED if state in "ZX" else _digest(boot + others[18])
    except (OSError, IndexError, ValueError):
        return _UNKNOWN


def temporary_name(path: Path) -> Path:
    """Make a hidden name beside `path` that tells who is writing: .NAME.HOST_PROCESS_BIRTH_TOKEN.tmp."""
    process = os.getpid()
    return path.with_name(f".{path.name}.{_HERE}_{process}_{_birth(process)}_{secrets.token_hex(4)}.tmp")


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Raise NteError, naming `path`, if a file cannot be written in this block (no space left, no permission)."""
    try:
        yield
    except OSError as error:
        raise NteError(f"{path}: cannot be written: {error.strerror or error}") from error


@contextmanager
def whole(path: Path, of_many: bool = False) -> Iterator[Path]:
    """Yield a temporary name beside `path`; the file of that name is renamed after the block, or removed if it raises.

    Leftovers of this file from killed processes are removed first. of_many: they are not, so that their folder must be
    swept once, and nothing waits for the disk: after a power cut the file may be torn. Raises NteError if it cannot be
    renamed.
    """
    if not of_many:
        sweep(path.parent, path.name)
    temporary = temporary_name(path)
    try:
        yield temporary
        with writing(path):
            if not of_many:
                with temporary.open("rb") as file:
                    os.fsync(file.fileno())
            temporary.replace(path)
    finally:
        with suppress(OSError):  # from a folder that cannot be written to: the error above says so
            temporary.unlink(missing_ok=True)


def write_whole(path: Path, write: Callable[[Path], object], of_many: bool = False) -> None:
    """Call `write` with a temporary name beside `path`, so that the file is whole or absent.

    of_many: see `whole`. Raises NteError, with the temporary file removed, if writing fails (no space left, no
    permission).
    """
    path = Path(path)
    try:
        with whole(path, of_many) as temporary:
            write(temporary)
    except (OSError, RuntimeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise NteError(f"{path}: cannot be written: {reason}") from error


def sweep(folder: Path, name: str = "*") -> None:
    """Delete the temporary files and folders of `name` in a folder if their writer was killed on this machine.

    name: a file's or folder's name, or "*" for all. Errors of the file system are ignored.
    """
    with suppress(OSError):
        for path in folder.glob(f".{glob.escape(name) if name != '*' else name}.*.tmp"):
            if not is_abandoned(path):
                continue
            if path.is_dir() and not path.is_symlink():
                shutil.rmtree(path, ignore_errors=True)
            else:
                path.unlink(missing_ok=True)


def is_abandoned(path: Path) -> bool:
    """Tell whether a temporary file's writer ran on this machine and is dead; one on another machine may be alive."""
    found = _OWNER.search(path.name)
    if found is None or found["host"] != _HERE:
        return False
    process = int(found["process"])
    if _UNKNOWN not in (born := {found["birth"], _birth(process)}):
        return len(born) == 2  # another process has the number now
    if process == os.getpid():
        return False
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return True
    except (OSError, OverflowError):  # somebody else's process is alive as well
        return False
    return False


def is_file_or_lost(path: Path) -> bool:
    """Tell whether a path is a file, or a link to nothing: a lost frame must not shorten a sequence in silence."""
    return path.is_file() or (path.is_symlink() and not path.exists())


def remove(path: Path) -> None:
    """Delete a file, or a link to one, if it is there. Raises NteError if that is not permitted."""
    if not os.path.lexists(path):
        return
    try:
        path.unlink(missing_ok=True)
    except OSError as error:
        raise NteError(f"{path}: cannot be deleted: {error.strerror}") from error


def make_folder(folder: Path) -> None:
    """Make a folder and its parents. Raises NteError if a file is in the way or it is not permitted."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise NteError(f"{folder}: cannot be made a folder: {error.strerror}") from error


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


def refuse_pipe(path: Path) -> None:
    """Raise NteError for a pipe: reading it would wait, without end, for somebody who writes.

    Raises OSError as reading does.
    """
    if path.is_fifo():
        raise NteError(f"{path}: is a pipe, expected a file")


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
        own_name = _OWNER.fullmatch(other.name[len(path.name) + 1 :])
        if other != mine and own_name and own_name["host"] == _HERE and not is_abandoned(other):
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


def is_folder_name(name: str) -> bool:
    """Tell whether a text can name a folder: one part of a path, at most 200 bytes, no control characters."""
    return Path(name).name == name and name not in ("", "..") and len(name.encode()) <= 200 and name.isprintable()


def is_inside(path: Path, folder: Path) -> bool:
    """Tell whether a path, once its links are followed, lies below `folder`: for paths that others' files name."""
    try:
        return Path(os.path.realpath(path)).is_relative_to(os.path.realpath(folder))
    except ValueError:  # a NUL character
        return False


def already_there(path: Path, other: str = "name", remedy: str = "overwrite it") -> NteError:
    """Make the error for a path that exists and that only --force may replace.

    other: the kind of thing to choose instead, a name or a folder. remedy: what --force does.
    """
    return NteError(f"{path}: exists: choose another {other}, or {remedy} with --force")


def refuse_to_replace(paths: Iterable[Path], force: bool) -> None:
    """Raise NteError for the first of the paths that exists, unless `force`."""
    for path in paths:
        if path.exists() and not force:
            raise already_there(path, "folder")


def refuse_links(folder: Path) -> None:
    """Raise NteError for a symbolic link below `folder`: its target would be written to, or deleted."""
    for path in folder.rglob("*"):  # does not descend into links
        if path.is_symlink():
            raise NteError(f"{path}: is a link to {os.readlink(path)}: nothing is written through links; remove it")
