"""Files that are whole or absent, what must not be replaced, and the removal of what killed processes leave behind."""

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


def is_at_work(temporary: Path, name: str) -> bool:
    """Tell whether a temporary name stands for the file `name`, and the process that gave it lives on this machine."""
    own = _OWNER.fullmatch(temporary.name[len(name) + 1 :])
    return bool(own and own["host"] == _HERE and not is_abandoned(temporary))


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


def refuse_pipe(path: Path) -> None:
    """Raise NteError for a pipe: reading it would wait, without end, for somebody who writes.

    Raises OSError as reading does.
    """
    if path.is_fifo():
        raise NteError(f"{path}: is a pipe, expected a file")


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
