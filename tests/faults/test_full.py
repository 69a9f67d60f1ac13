"""Commands whose disk becomes full: one line, nothing half-written; with space again they end as if undisturbed."""

import json
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import yaml
from PIL import Image

from nte import load_denoiser
from nte.cli import main
from nte.frames.exr import read_layers
from nte.training.checkpoint import read_checkpoint
from nte.unfinished import MARK
from nte.viewer.page import PAGE
from nte.viewer.recorder import FOLDER as LAYERS
from tests.conftest import Rounds
from tests.faults.commands import COMMANDS, FOLDER, command, contents, differing

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore::nte.motion.correspondence.FewerLevelsWarning")]
BLOCK = 4096


class Disk:
    """A folder that is a file system of its own."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        folder.mkdir()

    def empty(self, size: int) -> Path:
        """Begin anew, with so many bytes."""
        self.close()
        self._mount(f"size={size}")
        return self.folder

    def enlarge(self) -> None:
        """Make space for everything."""
        self._mount(f"remount,size={64 << 20}")

    def close(self) -> None:
        if self.folder.is_mount():
            subprocess.run(["umount", str(self.folder)], check=True)

    def _mount(self, options: str) -> None:
        command = ["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(self.folder)]
        if subprocess.run(command, capture_output=True, check=False).returncode:
            pytest.skip("this machine lets us mount nothing")


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Disk]:
    made = Disk(tmp_path / "disk")
    yield made
    made.close()


def _read_picture(path: Path) -> None:
    with Image.open(path) as picture:
        picture.load()


# What a command left is read to its end, as whoever finds it would; a file that is torn fails.
READERS: dict[str, Callable[[Path], object]] = {
    ".exr": read_layers,
    ".json": lambda path: json.loads(path.read_text("utf-8")),
    # A log's last line may lack its end: a resumed run drops it.
    ".jsonl": lambda path: [json.loads(line) for line in path.read_text("utf-8").split("\n")[:-1]],
    ".onnx": lambda path: load_denoiser(str(path)),
    ".png": _read_picture,
    ".safetensors": lambda path: read_checkpoint(path.parent, path.name),
    ".yaml": lambda path: yaml.safe_load(path.read_text("utf-8")),
}


def is_read(out: Path, file: str) -> bool:
    """Whether anything reads a file: nothing reads the layers of a page that is not there."""
    parts = Path(file).parts
    return LAYERS not in parts or out.joinpath(*parts[: parts.index(LAYERS)], PAGE).exists()


@pytest.mark.parametrize("name", COMMANDS)
def test_it_says_so_and_goes_on_when_there_is_space(
    name: str, noisy_disc: Path, run: Path, disk: Disk, tmp_path: Path, rounds: Rounds,
    capfd: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    if name == "render":
        load_mitsuba = pytest.importorskip("nte.render.engine.backend").load_mitsuba
        load_mitsuba()
    undisturbed = tmp_path / "undisturbed"
    assert main(command(name, undisturbed, noisy_disc, run, tmp_path)) == 0
    expected = contents(undisturbed)
    blocks = sum(-(-path.stat().st_size // BLOCK) for path in undisturbed.rglob("*") if path.is_file())
    count = rounds("disks that became full", 1, 12)
    for number in range(count):
        place = disk.empty(max(1, int(blocks * (number + 0.5) / count)) * BLOCK)
        out = place / f"out {number}"
        words = command(name, out, noisy_disc, run, tmp_path)
        capfd.readouterr()
        assert main(words) == 2, number
        lines = [line for line in capfd.readouterr().err.splitlines() if line.startswith("nte: ")]
        (line,) = [line for line in lines if not line.startswith("nte: warning")]
        assert str(out) in line
        assert "No space left on device" in line
        left = {name: data for name, data in contents(out).items() if data != FOLDER}
        left.pop(MARK, None)
        left = {file: data for file, data in left.items() if is_read(out, file)}
        earlier = {file for file in left if file.endswith(".safetensors")}  # a checkpoint is that of an earlier step
        assert {file for file in left if left[file] != expected.get(file)} <= earlier, number
        for file in left:
            READERS.get(Path(file).suffix, Path.read_bytes)(out / file)
        disk.enlarge()
        assert main(words) == 0, number
        assert not differing(contents(out), expected), number
