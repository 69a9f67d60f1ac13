"""Figures of benchmarks are kept, by machine, and their history is told."""

import json
from pathlib import Path

import pytest

from benchmarks import history
from benchmarks.record import read, record
from nte.errors import NteError


def test_runs_are_appended_and_read_in_the_order_of_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("benchmarks.record.machine", lambda: "büro 1, CPU @ 2 GHz, 2 cores")
    first = record("kernels", {"forward": 1.5, "backward": 3.0}, "ms", tmp_path)
    second = record("kernels", {"forward": 1.25}, "ms", tmp_path)
    assert first == second
    assert first.name == "b-ro-1-CPU-2-GHz-2-cores.jsonl"
    lines = [json.loads(line) for line in first.read_text(encoding="utf-8").splitlines()]
    assert {tuple(line) for line in lines} == {("name", "value", "unit", "machine", "commit", "date")}
    assert [(figure.name, figure.value) for figure in read(tmp_path)] == [
        ("kernels: forward", 1.5),
        ("kernels: backward", 3.0),
        ("kernels: forward", 1.25),
    ]
    assert {figure.machine for figure in read(tmp_path)} == {"büro 1, CPU @ 2 GHz, 2 cores"}


def test_the_history_has_every_run_and_the_overview_the_last(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for place, value in (("a", 1.0), ("b", 8.0), ("a", 2.0)):
        monkeypatch.setattr("benchmarks.record.machine", lambda place=place: place)
        record("kernels", {"forward": value, "backward": 10 * value}, "ms", tmp_path)
    history.main(["Forward"], tmp_path)
    rows = [line.split() for line in capsys.readouterr().out.splitlines()[1:]]
    assert [(row[1], row[2], row[-1]) for row in rows] == [
        ("forward", "1", "a"),
        ("forward", "2", "a"),
        ("forward", "8", "b"),
    ]
    history.main([], tmp_path)
    rows = [line.split() for line in capsys.readouterr().out.splitlines()[1:]]
    assert [(row[1], row[2]) for row in rows] == [
        ("backward", "20"),
        ("forward", "2"),
        ("backward", "80"),
        ("forward", "8"),
    ]


def test_what_is_not_there_is_said(tmp_path: Path) -> None:
    with pytest.raises(NteError, match="no figure is kept yet"):
        history.main([], tmp_path)
    record("kernels", {"forward": 1.0}, "ms", tmp_path)
    with pytest.raises(NteError, match="no figure is called 'sideways': there is kernels: forward"):
        history.main(["sideways"], tmp_path)
