"""Choice of the Mitsuba variant to render with, and of the LLVM that it uses.

Dr.Jit loads any LLVM that it finds. Versions 15 and 16 abort the whole process in the middle of a rendering («Cannot
select … fminimum»), and no `try` can catch that. So the version is read from the library's file before anything is
loaded, and DRJIT_LIBLLVM_PATH always names a library that was checked.
"""

import gc
import importlib
import importlib.metadata
import mmap
import multiprocessing
import os
import re
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path

from nte.errors import NteError, needs_extra
from nte.interrupt import InterruptFlag
from nte.render.engine.types import Module

OLDEST_LLVM = 17
_VARIABLE = "DRJIT_LIBLLVM_PATH"
_WHEEL = "karellen-llvm-core"
_LIBRARY_NAMES = ("libLLVM*.so*", "libLLVM*.dylib")
_SYSTEM_FOLDERS = (
    "/usr/lib/x86_64-linux-gnu", "/usr/lib/aarch64-linux-gnu", "/usr/lib64", "/usr/lib", "/usr/local/lib",
    "/usr/lib/llvm-*/lib", "/usr/lib64/llvm*/lib", "/opt/homebrew/opt/llvm*/lib", "/usr/local/opt/llvm*/lib",
)  # fmt: skip


@contextmanager
def undisturbed() -> Iterator[None]:
    """Suspend garbage collection within the block, and delay Ctrl-C to the block's end; a second Ctrl-C acts at once.

    Dr.Jit does not survive either of them everywhere: a scene that is freed in the middle of a recording aborts the
    process, and an exception in a recording crashes it or is reported as an error of Dr.Jit's own.
    """
    interrupted, was_on = InterruptFlag(), gc.isenabled()
    gc.disable()
    try:
        with interrupted:
            yield
    finally:
        if was_on:
            gc.enable()
    if interrupted():
        raise KeyboardInterrupt


@cache
@undisturbed()  # an interrupted import looks like a missing package
def load_mitsuba() -> Module:
    """Load the mitsuba module and set its variant: llvm_ad_rgb, or scalar_rgb where no usable LLVM is found.

    scalar_rgb is many times slower; one line on stderr says so. Raises NteError where Mitsuba is not installed, and
    where an LLVM that crashes is requested (DRJIT_LIBLLVM_PATH) or already loaded.
    """
    library = choose_llvm(os.environ.get(_VARIABLE))
    if library is not None:
        os.environ[_VARIABLE] = str(library)
    try:
        drjit = importlib.import_module("drjit")
        mitsuba = importlib.import_module("mitsuba")
    except ImportError as error:
        raise needs_extra("render", "rendering", error) from error
    if library is not None and drjit.has_backend(drjit.JitBackend.LLVM):
        _require_loaded(drjit.detail.llvm_version(), library)
        mitsuba.set_variant("llvm_ad_rgb")
        return mitsuba
    if multiprocessing.parent_process() is None:  # said once, not by every job
        why = f"{library} cannot be loaded" if library else f"no LLVM {OLDEST_LLVM} or newer is found"
        hint = f"to speed it up: pip install {_WHEEL}"
        print(f"nte: {why}: rendering with scalar_rgb, many times slower; {hint}", file=sys.stderr)
    mitsuba.set_variant("scalar_rgb")
    return mitsuba


def _require_loaded(version: tuple[int, int, int], library: Path) -> None:
    """Refuse an LLVM that Dr.Jit chose by itself, which happens when Dr.Jit is imported before nte.render."""
    if version[0] < OLDEST_LLVM:
        raise NteError(
            f"LLVM {version[0]}, which crashes Mitsuba, is already loaded: mitsuba was imported before nte.render; "
            f"set {_VARIABLE}={library} first"
        )


def load_drjit() -> Module:
    """Load the drjit module, after load_mitsuba has chosen its LLVM."""
    load_mitsuba()
    return importlib.import_module("drjit")


def is_scalar() -> bool:
    """Say whether Mitsuba handles one ray at a time instead of whole arrays of them."""
    return str(load_mitsuba().variant()).startswith("scalar")


def require_arrays(key: str) -> None:
    """Raise NteError where Mitsuba runs without LLVM. key: the key of a recipe that needs arrays of rays."""
    if is_scalar():
        raise NteError(f"'{key}' needs Mitsuba's llvm variant: pip install karellen-llvm-core, or leave '{key}' out")


def share_cores(jobs: int) -> None:
    """Limit this process to its share of the cores, for `jobs` processes that render side by side."""
    if not is_scalar():
        load_drjit().set_thread_count(max(1, (os.cpu_count() or 1) // jobs))


def choose_llvm(given: str | None) -> Path | None:
    """Choose the LLVM library: the one that the user names, else the wheel's, else the newest usable one of the system.

    given: the value of DRJIT_LIBLLVM_PATH, or None. Returns None if there is no usable library. Raises NteError if
    the given library does not exist or is too old; it is never silently replaced.
    """
    if given:
        path = Path(given)
        if not path.is_file():
            raise NteError(f"{_VARIABLE} is {given}: no such file; unset it or name a libLLVM library")
        version = llvm_version(path)
        if version is not None and version < OLDEST_LLVM:
            raise NteError(
                f"{_VARIABLE} is {given}: LLVM {version} crashes Mitsuba; expected {OLDEST_LLVM} or newer: "
                f"unset it, and pip install {_WHEEL}"
            )
        return path
    return newest_usable(_wheel_libraries()) or newest_usable(_system_libraries())


def newest_usable(candidates: Iterable[Path]) -> Path | None:
    """Return the candidate with the highest LLVM version of at least OLDEST_LLVM; skip unknown versions."""
    versions = {path: llvm_version(path) for path in sorted(candidates)}
    usable = {path: version for path, version in versions.items() if version and version >= OLDEST_LLVM}
    return max(usable, key=lambda path: usable[path], default=None)


def llvm_version(path: Path) -> int | None:
    """Read the major version of an LLVM library from its name, else from its symbol table; None if neither tells it.

    Names are libLLVM-15.so.1, libLLVM.so.19.1 or, behind a link, libLLVM.so. The library is not loaded.
    """
    for name in (path.name, path.resolve().name):
        if found := re.search(r"libLLVM-(\d+)", name) or re.search(r"libLLVM\.so\.(\d{2,})", name):
            return int(found[1])
    try:
        with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
            node = re.search(rb"\0LLVM_(\d+)(?:\.\d+)?\0", content)  # the version of its symbols
            return int(node[1]) if node else None
    except (OSError, ValueError):
        return None


def _wheel_libraries() -> list[Path]:
    """Libraries of the PyPI wheel, which installs them in the environment's data folder."""
    try:
        files = importlib.metadata.files(_WHEEL) or []
    except importlib.metadata.PackageNotFoundError:
        return []
    paths = [Path(str(file.locate())) for file in files if file.name.startswith("libLLVM")]
    return [path.resolve() for path in paths if path.is_file()]


def _system_libraries() -> list[Path]:
    root = Path("/")
    folders = [folder for pattern in _SYSTEM_FOLDERS for folder in root.glob(pattern.lstrip("/"))]
    return [path for folder in folders for name in _LIBRARY_NAMES for path in folder.glob(name)]
