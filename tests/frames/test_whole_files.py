"""A frame is whole or absent, whatever happens while it is written."""

import random
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from nte.errors import NteError
from nte.files import write_whole
from nte.frames.clip import write_frame
from nte.frames.clip_info import write_clip_info
from nte.frames.exr import read_exr, write_exr
from tests.synthetic import disc_frame


def test_a_failure_leaves_the_old_file_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_text("old")

    def fail(temporary: Path) -> None:
        temporary.write_text("half")
        raise OSError(28, "No space left on device")

    with pytest.raises(NteError, match=r"a\.txt: cannot be written: No space left on device"):
        write_whole(path, fail)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_an_interruption_leaves_nothing(tmp_path: Path) -> None:
    def interrupt(temporary: Path) -> None:
        temporary.write_text("half")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_whole(tmp_path / "a.txt", interrupt)
    assert not list(tmp_path.iterdir())


def test_folders_are_made_and_a_file_in_the_way_is_named(tmp_path: Path) -> None:
    write_frame(tmp_path / "new" / "seed_01" / "frame_0000.exr", disc_frame(0))
    assert (tmp_path / "new" / "seed_01" / "frame_0000.exr").is_file()
    (tmp_path / "file").write_text("")
    for write in (
        lambda: write_frame(tmp_path / "file" / "frame_0000.exr", disc_frame(0)),
        lambda: write_clip_info(tmp_path / "file" / "clip", {}),
    ):
        with pytest.raises(NteError, match=r"file.*: cannot be made a folder"):
            write()


def test_a_full_disk_is_one_line_and_leaves_nothing(tmp_path: Path) -> None:
    # A file may not grow beyond 4 KiB: the library meets what it would meet on a full disk.
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, before[1]))
    try:
        noise = np.random.default_rng(0).random((64, 64), np.float32)
        with pytest.raises(NteError, match=r"a\.exr: cannot be written") as error:
            write_exr(tmp_path / "a.exr", {"Z": noise})
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert "\n" not in str(error.value)
    assert not list(tmp_path.iterdir())


WRITER = """
import sys
from pathlib import Path
import numpy as np
from nte.frames.clip import write_frame
print("ready", flush=True)
for value in range(1, 100_000):
    write_frame(Path(sys.argv[1]), {"color": np.full((3, 90, 160), value % 1000, np.float32)})
"""


@pytest.mark.slow
def test_a_killed_writer_leaves_a_whole_frame(tmp_path: Path) -> None:
    path = tmp_path / "frame_0000.exr"
    rng = random.Random()
    for _ in range(5):
        process = subprocess.Popen([sys.executable, "-c", WRITER, str(path)], stdout=subprocess.PIPE)
        assert process.stdout is not None
        process.stdout.readline()
        time.sleep(rng.uniform(0.02, 0.2))
        process.send_signal(signal.SIGKILL)
        process.wait()
        if path.exists():
            color = read_exr(path)["color.R"]
            assert (color == color[0, 0]).all()
    assert path.exists()
