"""The core seconds of an evaluation: a line for the noisy input, and one for each denoiser."""

from pathlib import Path

import pytest

from benchmarks import evaluation


def test_a_denoiser_costs_more_than_the_noisy_input(
    noisy_disc: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    given = iter([5.0, 0.25, 0.75])  # imports, the noisy input, the denoiser
    monkeypatch.setattr(evaluation, "seconds", lambda clip, spec: next(given))
    evaluation.main([str(noisy_disc), "taa"])
    assert [line.split() for line in capsys.readouterr().out.splitlines()] == [
        ["s/frame", "own"], ["noisy:target=color", "0.250", "–"], ["taa", "0.750", "0.500"],
    ]  # fmt: skip


def test_seconds_are_those_of_the_processor(noisy_disc: Path) -> None:
    assert 0 < evaluation.seconds(noisy_disc, "noisy") < 60
