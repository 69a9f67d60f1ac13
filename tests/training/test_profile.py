"""nte train --profile: what it measures adds up, counts a step's operations, and leaves nothing behind."""

from pathlib import Path

import pytest

from nte.cli import main
from nte.errors import NteError
from nte.training.meter import STAGES
from nte.training.profile import Profile, profile_training
from tests.training.runs import config_file, tiny_config


@pytest.mark.slow
def test_a_profile_has_every_stage_and_no_run(tmp_path: Path, noisy_disc: Path, capsys: pytest.CaptureFixture) -> None:
    path = config_file(tmp_path, noisy_disc)
    assert main(["train", str(path), "--profile", "--device", "cpu"]) == 0
    said = capsys.readouterr().out
    rows = [line.split()[0] for line in said.splitlines()[1:-1]]
    assert [row for row in rows if row in STAGES] == list(STAGES)
    assert {"train/denoiser", "train/losses"} <= {*rows[rows.index("forward") : rows.index("backward")]}
    assert "GFLOP/s that a large convolution alone reaches here" in said
    assert not (tmp_path / "runs").exists()


@pytest.mark.slow
def test_operations_grow_with_the_batches_of_a_step(
    tmp_path: Path, noisy_disc: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("nte.training.profile.convolution_peak", lambda *_, **__: 1e9)
    found = [
        profile_training(tiny_config(tmp_path, noisy_disc, f"optimiser.accumulate={n}", "phases=[{steps: 9}]"), "cpu")
        for n in (1, 2)
    ]
    assert found[1].operations == 2 * found[0].operations > 0


def test_a_share_by_hand() -> None:
    profile = Profile(dict(zip(STAGES, (1.0, 2.0, 4.0, 1.0), strict=True)), {"train/denoiser": 1.5}, 4e9, 1e9)
    assert profile.share == 0.5
    lines = profile.table().splitlines()
    assert lines[2].split() == ["forward", "2.000", "25%"]
    assert lines[3].split() == ["train/denoiser", "1.500", "19%"]
    assert lines[-1].startswith("4 GFLOP a step in 8 s: 50% of the 1 GFLOP/s")


def test_a_run_that_is_too_short_for_it(tmp_path: Path, noisy_disc: Path) -> None:
    with pytest.raises(NteError, match="'phases' have 3 steps, expected at least 6 for a profile"):
        profile_training(tiny_config(tmp_path, noisy_disc, "phases=[{steps: 3}]"), "cpu")
