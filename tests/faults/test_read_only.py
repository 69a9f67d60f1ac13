"""Every command that writes, where nothing can be written: exit code 2, one line, and no long work before it."""

import importlib.util
import re
from pathlib import Path

import pytest

from nte.cli import _COMMANDS, main
from tests.training.runs import config_file

FILES = {
    "map.yaml": "channels: {color: color, albedo: albedo, normal: normal}",
    "recipe.yaml": "name: x\ntrain: [{scene: rooms, clips: 1, width: 16, height: 16, frames: 1, reference_spp: 4}]",
    "compare.yaml": "recipes: {}\nsituations: [{name: disc, clips: [disc], methods: {nothing: noisy}}]",
    "rendered.yaml": "recipes: {.: recipe.yaml}\nsituations: [{name: a, clips: ['*/*'], methods: {nothing: noisy}}]",
}
COMMANDS = (
    "render recipe.yaml --out OUT",
    "train tiny.yaml runs=OUT --device cpu",
    "evaluate --clips CLIP --denoisers noisy --out OUT",
    "compare compare.yaml --data DATA --out OUT",
    "compare rendered.yaml --data OUT --out out",
    "export CLIP --out OUT/model.onnx",
    "denoise CLIP --denoiser noisy --png --out OUT",
    "denoise CLIP/frame_0000.exr --denoiser noisy --out OUT",
    "estimate CLIP --out OUT --noise clean",
    "import exr CLIP --map map.yaml --out OUT",
    "bench noisy --size 32x32 --json OUT/bench.json",
    "demo --out OUT",
    "merge-burst CLIP/frame_0000.exr CLIP/frame_0001.exr --out OUT/merged.exr",
    "check CLIP --picture OUT",
    "view CLIP --out OUT --no-open",
)
NEEDED = {"render": "mitsuba", "compare rendered": "mitsuba", "demo": "pyoidn", "merge-burst": "rawpy"}


def test_every_command_is_among_them() -> None:
    writing = {module.__name__.rpartition(".")[2].removesuffix("_clip").replace("_", "-") for module in _COMMANDS}
    assert {command.split()[0] for command in COMMANDS} == writing - {"info"}


@pytest.mark.filterwarnings("ignore::nte.motion.correspondence.FewerLevelsWarning")
@pytest.mark.parametrize("place", ["", "new/folder"])
@pytest.mark.parametrize("command", COMMANDS, ids=lambda command: command.partition(" --")[0])
def test_it_says_so_in_one_line(
    command: str, place: str, read_only: Path, noisy_disc: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    for start, module in NEEDED.items():
        if command.startswith(start) and importlib.util.find_spec(module) is None:
            pytest.skip(f"{module} is not installed")
    monkeypatch.chdir(tmp_path)
    for name, text in FILES.items():
        Path(name).write_text(text + "\n")
    config_file(tmp_path, noisy_disc)
    places = {"OUT": read_only / place, "CLIP": noisy_disc, "DATA": noisy_disc.parent}
    for word, path in places.items():
        command = command.replace(word, str(path))
    before = {path.name for path in tmp_path.iterdir()}
    assert main(command.split()) == 2
    lines = [line for line in capfd.readouterr().err.splitlines() if line.startswith("nte: ")]
    (line,) = [line for line in lines if not line.startswith("nte: warning")]
    said = r"cannot be (written|made a folder)|Read-only file system|its folder does not exist"
    assert re.search(rf"{read_only}.*({said})", line)
    assert {path.name for path in tmp_path.iterdir()} == before
