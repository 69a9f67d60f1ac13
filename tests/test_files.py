"""Files stay whole, also when processes are killed or the disk is read-only."""

import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from nte.errors import NteError
from nte.files import is_abandoned, refuse_links, remove, sweep, temporary_name, write_whole
from nte.writers import only_writer, only_writer_of


def killed(code: str, *arguments: object) -> None:
    """Run Python until it prints a line, then kill it."""
    command = [sys.executable, "-c", code + "; print(flush=True); import time; time.sleep(60)", *map(str, arguments)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "\n"
        process.send_signal(signal.SIGKILL)


@pytest.mark.slow
def test_what_a_killed_writer_left_is_gone_after_the_next_write(tmp_path: Path) -> None:
    name = "a[1] ü.txt"
    begin = "import sys; from pathlib import Path; from nte.files import temporary_name as name; "
    killed(begin + "p = Path(sys.argv[1]); name(p).write_text('half'); name(p).mkdir()", tmp_path / name)
    killed(begin + "name(Path(sys.argv[1])).write_text('half')", tmp_path / "other.txt")
    (left,) = tmp_path.glob(".other.txt.*")
    assert len(list(tmp_path.iterdir())) == 3
    assert is_abandoned(left)
    mine, elsewhere = temporary_name(tmp_path / name), tmp_path / f".{name}.00000000_1_00000000_00000000.tmp"
    for path in (mine, elsewhere, tmp_path / f".{name}.tmp", tmp_path / f".{name}.mine.tmp"):
        path.write_text("somebody is writing, or nobody knows")
    write_whole(tmp_path / name, lambda path: path.write_text("whole"))
    assert {path.name for path in tmp_path.iterdir()} == {
        name, left.name, mine.name, elsewhere.name, f".{name}.tmp", f".{name}.mine.tmp"
    }  # fmt: skip
    sweep(tmp_path)
    assert not left.exists()
    assert mine.exists()


def test_a_killed_writer_is_dead_though_its_parent_has_not_yet_asked(tmp_path: Path) -> None:
    """A worker's parent may wait for something else: until it asks, the system keeps the worker's number."""
    code = "import sys; from pathlib import Path; from nte.files import temporary_name as name; "
    code += "name(Path(sys.argv[1])).touch(); print(flush=True); sys.stdin.read()"
    command = [sys.executable, "-c", code, str(tmp_path / "a.txt")]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        process.stdout.readline()
        (left,) = tmp_path.iterdir()
        assert not is_abandoned(left)
        process.kill()
        assert process.stdout.read() == ""  # its end, which the system tells before the process is gone
        os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOWAIT)  # ended, and left in the system's list
        assert is_abandoned(left)


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="this system does not tell when a process began")
@pytest.mark.parametrize("now", [os.getpid, os.getppid])
def test_a_leftover_whose_number_another_process_has_now_is_one(now: Callable[[], int], tmp_path: Path) -> None:
    """As after a reboot, or in a container that is started again: its first process has the number 1 each time."""
    path = tmp_path / "model.onnx"
    command = [
        sys.executable,
        "-c",
        f"from nte.files import *; print(temporary_name(Path({str(path)!r})), os.getpid())",
    ]
    left, _, number = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True).stdout.rpartition(" ")
    Path(left.replace(f"_{int(number)}_", f"_{now()}_")).touch()
    with only_writer_of(path, force=False):
        assert len(list(tmp_path.iterdir())) == 1
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_containers_with_one_name_leave_each_others_files_alone(tmp_path: Path) -> None:
    """A container has numbers of its own: that of a live process outside is nobody's there, or somebody else's."""
    apart = ["unshare", "--pid", "--fork", "--mount-proc"]
    if shutil.which("unshare") is None or subprocess.run([*apart, "true"], capture_output=True, check=False).returncode:
        pytest.skip("this machine lets us make no namespaces")
    mine = temporary_name(tmp_path / "model.onnx")
    mine.touch()
    code = "import sys; from pathlib import Path; from nte.files import sweep; sweep(Path(sys.argv[1]))"
    subprocess.run([*apart, sys.executable, "-c", code, str(tmp_path)], check=True)
    assert mine.exists()


def test_links_are_refused_at_any_depth_and_not_followed(tmp_path: Path) -> None:
    outside, out = tmp_path / "outside", tmp_path / "out"
    (out / "train" / "rooms_000").mkdir(parents=True)
    outside.mkdir()
    refuse_links(out)
    refuse_links(tmp_path / "nowhere")
    os.symlink(out, outside / "out")
    os.symlink(outside, out / "train" / "rooms_001")
    with pytest.raises(NteError, match=r"rooms_001: is a link to .*outside: nothing is written through links"):
        refuse_links(out)
    refuse_links(outside / "out" / "train" / "rooms_000")  # the folder itself may be reached by a link


def test_a_read_only_folder_is_one_line(read_only: Path) -> None:
    with pytest.raises(NteError, match=r"a.txt: cannot be written: Read-only file system"):
        write_whole(read_only / "a.txt", lambda path: path.write_text("x"))
    with (
        pytest.raises(NteError, match=r"new: cannot be made a folder: Read-only file system"),
        only_writer(read_only / "new"),
    ):
        pass
    remove(read_only / "nothing there")
    with (
        pytest.raises(NteError, match=r"a.txt: cannot be written: Read-only file system"),
        only_writer_of(read_only / "a.txt", force=False),
    ):
        pass


def test_a_link_is_removed_and_what_it_points_to_stays(tmp_path: Path) -> None:
    (tmp_path / "mine").write_text("mine")
    for target in ("mine", "nowhere"):
        (tmp_path / "link").symlink_to(tmp_path / target)
        remove(tmp_path / "link")
        assert [path.name for path in tmp_path.iterdir()] == ["mine"]
    (tmp_path / "folder").mkdir()
    with pytest.raises(NteError, match=r"folder: cannot be deleted"):
        remove(tmp_path / "folder")
