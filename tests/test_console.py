"""Stdout and stderr that are full, closed or read by nobody, and names that would steer a terminal."""

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

import numpy as np
import pytest

from nte.cli import main
from nte.errors import NteError, printable
from nte.frames.exr import write_exr

Stream = Callable[[], AbstractContextManager[int | None]]
HOSTILE = {
    "newline": ("a\nnte:well", r"a\nnte:well"),
    "escape": ("a\x1b[2Jb", r"a\x1b[2Jb"),
    "bidi": ("a\u202egpj.exe", r"a\u202egpj.exe"),
    "no text": ("a\udcffb", r"a\udcffb"),
}
SHOWN = [name for name in HOSTILE if name != "no text"]  # the OpenEXR library takes no such name


@pytest.fixture(params=HOSTILE)
def hostile(request: pytest.FixtureRequest) -> tuple[str, str]:
    """A name, and how it is shown."""
    return HOSTILE[request.param]


def test_an_error_is_one_line_whatever_it_quotes(hostile: tuple[str, str], capfd: pytest.CaptureFixture[str]) -> None:
    name, shown = hostile
    assert str(NteError(f"{name}: is bad")) == f"{shown}: is bad"
    assert main(["info", name]) == 2
    (line,) = capfd.readouterr().err.splitlines()
    assert line.startswith(f"nte: {shown}: expected a clip")


def test_wrong_usage_is_one_line_whatever_it_quotes(
    hostile: tuple[str, str], capfd: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        main(["check", "clip", f"--{hostile[0]}"])
    (line,) = capfd.readouterr().err.splitlines()
    assert f"unrecognised arguments: --{hostile[1]}; see" in line


def test_what_the_system_refuses_is_one_line(hostile: tuple[str, str], capfd: pytest.CaptureFixture[str]) -> None:
    name, shown = hostile
    assert main(["info", name + "x" * 300]) == 2
    (line,) = capfd.readouterr().err.splitlines()
    assert line == f"nte: {shown}{'x' * 300}: File name too long"


@pytest.mark.parametrize("name", SHOWN)
def test_results_show_names_escaped(
    name: str, noisy_disc: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    called, shown = HOSTILE[name]
    clip = tmp_path / called
    shutil.copytree(noisy_disc, clip)
    for command in ("info", "check"):
        assert main([command, str(clip)]) == 0
        lines = capfd.readouterr().out.splitlines()
        assert all(printable(line) == line for line in lines)
        assert sum(shown in line for line in lines) == 1


@pytest.mark.parametrize("name", SHOWN)
def test_channels_of_a_file_are_named_escaped(name: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    called, shown = HOSTILE[name]
    (tmp_path / "shots").mkdir()
    layers = {f"{called}.{one}": np.ones((8, 8), np.float32) for one in "RGB"}
    write_exr(tmp_path / "shots" / "a.0001.exr", layers)
    map_path = tmp_path / "map.yaml"
    map_path.write_text("channels: {color: beauty}")
    command = ["import", "exr", str(tmp_path / "shots"), "--map", str(map_path), "--out", str(tmp_path / "clip")]
    assert main(command) == 2
    (line,) = capfd.readouterr().err.splitlines()
    assert f"{shown}.R" in line
    map_path.write_text(json.dumps({"channels": {"color": called}}))
    assert main(command) == 0
    out = capfd.readouterr().out
    assert all(printable(line) == line for line in out.splitlines())


@contextmanager
def nobody_reads() -> Iterator[int]:
    """A pipe whose reader has gone."""
    reader, writer = os.pipe()
    os.close(reader)
    yield writer
    os.close(writer)


@contextmanager
def full() -> Iterator[int]:
    """A device on which no space is left."""
    if not Path("/dev/full").exists():
        pytest.skip("this system has no full device")
    with open("/dev/full", "w") as file:
        yield file.fileno()


@contextmanager
def closed() -> Iterator[None]:
    yield None


def ended(arguments: list[str], **streams: int | None) -> "subprocess.CompletedProcess[str]":
    """Run a command with streams in the place of stdout and stderr; None: a closed one. The others are captured."""
    shut = " ".join(f"{number}>&-" for number, name in ((1, "stdout"), (2, "stderr")) if streams.get(name, 0) is None)
    given: dict[str, int] = {name: stream for name, stream in streams.items() if stream is not None}
    return subprocess.run(
        ["sh", "-c", f'exec "$@" {shut}', "sh", sys.executable, "-m", "nte", *arguments],
        env={**os.environ, "PYTHONUNBUFFERED": ""},
        text=True,
        timeout=300,
        check=False,
        **({"stdout": subprocess.PIPE, "stderr": subprocess.PIPE} | given),
    )


@pytest.mark.slow
@pytest.mark.parametrize("what", [full, closed, nobody_reads])
def test_an_error_that_nobody_can_read_keeps_its_status(what: Stream) -> None:
    with what() as stream:
        done = ended(["info", "nowhere"], stderr=stream)
    assert (done.returncode, done.stdout) == (2, "")


@pytest.mark.slow
@pytest.mark.parametrize("what", [full, closed, nobody_reads])
def test_work_goes_on_where_nobody_can_read_its_progress(what: Stream, noisy_disc: Path, tmp_path: Path) -> None:
    words = ["denoise", str(noisy_disc), "--denoiser", "noisy", "--out", str(tmp_path / "out")]
    with what() as stream:
        done = ended(words, stderr=stream)
    assert (done.returncode, done.stdout) == (0, f"4 frames in {tmp_path / 'out'}\n")


@pytest.mark.slow
@pytest.mark.parametrize("words", ["info CLIP", "--help", "check --help", "--version"])
@pytest.mark.parametrize(
    ("what", "status", "said"),
    [(full, 2, "nte: stdout: cannot be written: No space left on device\n"), (closed, 0, ""), (nobody_reads, 141, "")],
)
def test_results_that_cannot_be_printed(words: str, what: Stream, status: int, said: str, noisy_disc: Path) -> None:
    with what() as stream:
        done = ended(words.replace("CLIP", str(noisy_disc)).split(), stdout=stream)
    assert (done.returncode, done.stderr) == (status, said)


@pytest.mark.slow
def test_the_first_line_of_a_result(noisy_disc: Path) -> None:
    nte = f"{sys.executable} -m nte"
    done = subprocess.run(f"{nte} info {noisy_disc} | head -1", shell=True, capture_output=True, text=True, check=True)
    assert (done.stdout.count("\n"), done.stderr) == (1, "")
