"""A folder and a file have one writer at a time, also when processes are killed."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from nte.errors import NteError
from nte.files import temporary_name, write_whole
from nte.writers import only_writer, only_writer_of


@pytest.mark.slow
def test_a_folder_has_one_writer_and_its_death_frees_it(tmp_path: Path) -> None:
    folder = tmp_path / "out"
    code = "import sys; from pathlib import Path; from nte.writers import only_writer as w; c = w(Path(sys.argv[1])); "
    command = [sys.executable, "-c", code + "c.__enter__(); print(flush=True); sys.stdin.read()", str(folder)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "\n"
        with pytest.raises(NteError, match=r"out: another process is writing to it"), only_writer(folder):
            pass
        process.kill()
        process.wait()
    with only_writer(folder):
        (folder / "mine").touch()
    assert [path.name for path in folder.iterdir()] == ["mine"]  # no file holds the lock


def test_a_folder_that_stays_empty_does_not_stay_but_one_that_was_there_does(tmp_path: Path) -> None:
    for made in (False, True):
        folder = tmp_path / str(made)
        if made:
            folder.mkdir()
        with pytest.raises(NteError, match="wrong input"), only_writer(folder):
            raise NteError("wrong input")
        assert folder.exists() == made


@pytest.mark.parametrize("path", [Path(), Path("/")])
def test_a_folder_is_no_file_to_write(path: Path) -> None:
    with pytest.raises(NteError, match="has no file's name"), only_writer_of(path, force=True):
        pass


def name_of_parent(path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The temporary name that the process which has started this one would make."""
    with monkeypatch.context() as patch:
        patch.setattr(os, "getpid", os.getppid)
        return temporary_name(path)


def test_a_file_has_one_writer_and_is_not_replaced_without_force(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "new" / "model[1].onnx"
    with only_writer_of(path, force=False):
        write_whole(path, lambda temporary: temporary.write_text("first"))
    assert list(path.parent.iterdir()) == [path]
    with pytest.raises(NteError, match=r"model\[1\]\.onnx: exists: .*--force"), only_writer_of(path, force=False):
        pass
    alive = name_of_parent(path, monkeypatch).name
    other = path.with_name(alive.replace("model", "other.model"))
    other.touch()  # of another file
    with only_writer_of(path, force=True):
        pass
    path.with_name(alive).touch()
    with (
        pytest.raises(NteError, match=r"model\[1\]\.onnx: another process is writing it"),
        only_writer_of(path, force=True),
    ):
        pass
    assert {found.name for found in path.parent.iterdir()} == {path.name, alive, other.name}
    with pytest.raises(NteError, match="wrong input"), only_writer_of(tmp_path / "none" / "a", force=False):
        raise NteError("wrong input")
    assert not (tmp_path / "none").exists()


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork here")
def test_a_forked_worker_does_not_keep_the_folder_of_its_parent(tmp_path: Path) -> None:
    # As where a training is killed, and its loading workers have not noticed yet.
    (ended, end), (started, start) = os.pipe(), os.pipe()
    with only_writer(tmp_path):
        child = os.fork()
        if child == 0:
            os.write(start, b"x")
            os.read(ended, 1)
            os._exit(0)
        os.read(started, 1)
        with pytest.raises(NteError, match="another process is writing to it"), only_writer(tmp_path):
            pass
    try:
        with only_writer(tmp_path):
            pass
    finally:
        os.write(end, b"x")
        os.waitpid(child, 0)
        for descriptor in (ended, end, started, start):
            os.close(descriptor)


@pytest.mark.parametrize("renewed", [False, True])
def test_the_lock_of_a_folder_that_is_no_longer_there_is_worth_nothing(
    renewed: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As where a writer that has failed removes its empty folder while another one opens it."""
    fcntl = pytest.importorskip("fcntl")
    lock, folder = fcntl.flock, tmp_path / "out"

    def replace_and_lock(descriptor: int, operation: int) -> None:
        folder.rmdir()
        if renewed:
            (tmp_path / "other").touch()  # or the new folder could get the number of the old one
            folder.mkdir()
        lock(descriptor, operation)

    monkeypatch.setattr(fcntl, "flock", replace_and_lock)
    with pytest.raises(NteError, match="out: another process is writing to it"), only_writer(folder):
        pass
