"""What the benchmark of changing conditions says of a denoiser that is known: the noisy input itself."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.conditions import CUT, figures, main
from nte.frames.clip import Clip
from tests.evaluation.conftest import noisy_frames
from tests.synthetic import write_clip


def test_the_input_is_as_good_after_a_cut_and_in_any_light(tmp_path: Path) -> None:
    for name in "ab":
        write_clip(tmp_path / name, noisy_frames(CUT + 3, size=(24, 32)))
    found = figures("noisy", [Clip(tmp_path / name) for name in "ab"])
    assert found["frame 0: PSNR"] > 5
    assert found["light x 1/16: PSNR"] == pytest.approx(found["light x 1: PSNR"], abs=1e-3)
    assert found["without noise: 99.9th percentile of the change, %"] == 0
    lost = [value for name, value in found.items() if "cut" in name]
    assert len(lost) == 3
    assert not np.any(lost)


def test_history_that_stays_is_seen(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """TAA without a clamp keeps what was before a cut, and is better a few frames into a sequence than at its start."""
    pytest.importorskip("pyoidn")
    frames = noisy_frames(12, size=(24, 32))
    write_clip(tmp_path / "a", frames)
    light = ("color", "reference_a", "reference_b")
    write_clip(tmp_path / "b", [{**frame, **{name: 0.1 * frame[name] for name in light}} for frame in frames])
    found = figures("taa:clamp=none", [Clip(tmp_path / "a"), Clip(tmp_path / "b")])
    assert found["frame 4: PSNR"] > found["frame 0: PSNR"]
    assert found["frame 0 behind a cut: PSNR lost"] > 1
    main(["noisy", str(tmp_path)])
    rows = capsys.readouterr().out.splitlines()
    assert rows[0].split() == ["noisy", "oidn"]
    assert len(rows) > 10
