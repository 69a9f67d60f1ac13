"""Choosing an LLVM by looking at it, never by loading it."""

from pathlib import Path

import pytest

from nte.errors import NteError
from nte.render.engine import backend


def library(folder: Path, name: str, content: bytes = b"") -> Path:
    path = folder / name
    path.write_bytes(content)
    return path


@pytest.mark.parametrize(
    ("name", "version"),
    [
        ("libLLVM-15.so.1", 15), ("libLLVM-14.0.6.so", 14), ("libLLVM.so.19.1", 19), ("libLLVM.so.23.1", 23),
        ("libLLVM-19.so", 19), ("libLLVM.so", None),
    ],
)  # fmt: skip
def test_version_by_name(tmp_path: Path, name: str, version: int | None):
    assert backend.llvm_version(library(tmp_path, name)) == version


def test_version_behind_a_link(tmp_path: Path):
    library(tmp_path, "libLLVM-15.so.1")
    link = tmp_path / "libLLVM.so"
    link.symlink_to("libLLVM-15.so.1")
    assert backend.llvm_version(link) == 15


def test_version_by_symbols(tmp_path: Path):
    assert backend.llvm_version(library(tmp_path, "libmine.so", b"\x7fELF..\0LLVM_16\0..")) == 16


@pytest.mark.parametrize("version", [14, 15, 16])
def test_an_old_llvm_of_the_users_is_refused(tmp_path: Path, version: int):
    path = library(tmp_path, f"libLLVM-{version}.so.1")
    with pytest.raises(NteError, match=rf"libLLVM-{version}.*LLVM {version} crashes.*17 or newer") as caught:
        backend.choose_llvm(str(path))
    assert "\n" not in str(caught.value)


def test_a_missing_llvm_of_the_users_is_refused(tmp_path: Path):
    with pytest.raises(NteError, match="no such file"):
        backend.choose_llvm(str(tmp_path / "libLLVM.so.19"))


def test_the_users_llvm_wins(tmp_path: Path):
    path = library(tmp_path, "libLLVM.so.19.1")
    assert backend.choose_llvm(str(path)) == path


def test_wheel_before_system(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    wheel, system = library(tmp_path, "libLLVM.so.19.1"), library(tmp_path, "libLLVM-20.so.1")
    monkeypatch.setattr(backend, "_wheel_libraries", lambda: [wheel])
    monkeypatch.setattr(backend, "_system_libraries", lambda: [system])
    assert backend.choose_llvm(None) == wheel
    monkeypatch.setattr(backend, "_wheel_libraries", list)
    assert backend.choose_llvm(None) == system


def test_old_and_unknown_libraries_are_passed_over(tmp_path: Path):
    old, unknown = library(tmp_path, "libLLVM-15.so.1"), library(tmp_path, "libLLVM.so")
    assert backend.newest_usable([old, unknown]) is None
    new, newer = library(tmp_path, "libLLVM-18.so.1"), library(tmp_path, "libLLVM.so.21.1")
    assert backend.newest_usable([new, old, newer, unknown]) == newer


def test_an_old_llvm_that_is_already_loaded_is_refused():
    with pytest.raises(NteError, match=r"LLVM 15, which crashes.*already loaded"):
        backend._require_loaded((15, 0, 6), Path("/x/libLLVM.so.23.1"))
    backend._require_loaded((19, 1, 0), Path("/x/libLLVM.so.23.1"))
