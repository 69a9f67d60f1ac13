"""What changes around a command while it runs: files that disappear, a clock that jumps."""

import shutil
import time
from pathlib import Path

import numpy as np
import pytest

from nte.cli import main
from nte.frames import exr
from tests.faults.commands import command, contents, differing

pytestmark = [
    pytest.mark.filterwarnings("ignore::nte.motion.correspondence.FewerLevelsWarning"),
    pytest.mark.filterwarnings("ignore::nte.training.clips.BrokenClipWarning"),
]
READING = ("denoise", "loose frames", "estimate", "evaluate", "import", "view", "train")
TIMED = ("denoise", "estimate", "train", "export")


@pytest.mark.parametrize("name", READING)
def test_a_frame_that_disappears_is_named_and_nothing_looks_finished(
    name: str, noisy_disc: Path, run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    clip, load = tmp_path / "disc", exr.load_exr
    shutil.copytree(noisy_disc, clip)
    words = command(name, tmp_path / "out", clip, run, tmp_path)

    def load_or_lose(path: Path, size: tuple[int, int] | None = None) -> object:
        if path == clip / "frame_0002.exr":
            path.unlink(missing_ok=True)
        return load(path, size)

    monkeypatch.setattr(exr, "load_exr", load_or_lose)
    assert main(words) == 2
    lines = [line for line in capfd.readouterr().err.splitlines() if line.startswith("nte: ")]
    (line,) = [line for line in lines if not line.startswith("nte: warning")]
    assert str(clip / "frame_0002.exr") in line
    for mark in ("clip.json", "clip/clip.json", "index.html", "tiny/checkpoint.safetensors"):
        assert not (tmp_path / "out" / mark).exists(), mark


@pytest.mark.parametrize("name", TIMED)
def test_a_clock_that_jumps_changes_nothing(
    name: str, noisy_disc: Path, run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert main(command(name, tmp_path / "undisturbed", noisy_disc, run, tmp_path)) == 0
    now, rng = time.time, np.random.default_rng(0)
    monkeypatch.setattr(time, "time", lambda: now() + rng.uniform(-1e8, 1e8))  # years, in both directions
    assert main(command(name, tmp_path / "out", noisy_disc, run, tmp_path)) == 0
    assert not differing(contents(tmp_path / "out"), contents(tmp_path / "undisturbed"))
