"""`nte demo`: the first command of somebody who has just installed nte."""

import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from nte.cli import main
from nte.frames.clip import Clip
from nte.released import CLIP
from tests.runtime.test_base_install import nte_without_extras

pytest.importorskip("pyoidn")


def table(text: str) -> dict[str, tuple[float, ...]]:
    """The rows of the printed table: title → PSNR, flicker, milliseconds."""
    rows = [line.rsplit(maxsplit=3) for line in text.splitlines() if line[-1:].isdigit()]
    return {title: (float(psnr), float(flicker), float(ms)) for title, psnr, flicker, ms in rows}


@pytest.mark.slow
def test_it_shows_the_released_model_without_pytorch(tmp_path: Path) -> None:
    done = nte_without_extras("demo", "--out", tmp_path / "demo")
    assert done.returncode == 0, done.stderr
    found = table(done.stdout)
    assert [*found] == ["noisy, 1 spp", "OIDN high", "steady"]
    noisy, oidn, steady = found.values()
    assert steady[0] > oidn[0] > noisy[0] + 5
    assert steady[1] < 0.95 * oidn[1] < 0.5 * noisy[1]
    assert len(Clip(tmp_path / "demo")) == len(Clip(CLIP)) == 10
    assert len([*(tmp_path / "demo").glob("frame_*.png")]) == 10
    both = next(tmp_path.glob("demo/before_after.*"))
    assert f"{both}: before and after." in done.stdout
    with Image.open(both) as picture:
        half = np.asarray(picture.convert("RGB")).astype(float)
        rough = [np.abs(np.diff(part, axis=0)).mean() for part in np.array_split(half, 2, axis=1)]
        assert rough[0] > 3 * rough[1]  # the left half is noisy
    again = nte_without_extras("demo", "--out", tmp_path / "demo")
    assert (again.returncode, again.stdout) == (2, "")
    assert again.stderr.endswith("exists: choose another folder, or overwrite it with --force\n")


def test_without_open_image_denoise_the_extra_is_named(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setitem(sys.modules, "pyoidn", None)
    assert main(["demo", "--out", str(tmp_path / "demo")]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "pip install 'nte-denoiser[oidn]'" in line
    assert not (tmp_path / "demo").exists()
