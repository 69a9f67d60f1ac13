"""Progress where stderr is no terminal: a line for what is finished, and one now and then."""

import pytest

from nte.progress import Progress


def test_work_without_a_finished_part_tells_how_far_it_is(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    with Progress("render", 6, "frame") as progress:
        progress.advance(1)  # no line yet
        monkeypatch.setattr("nte.progress.INTERVAL", 0)
        progress.advance(1)
        progress.advance(0)
        monkeypatch.undo()
        progress.advance(2)
        progress.say("apples_000")
    assert capsys.readouterr().err.splitlines() == ["render (2/6 frames)", "apples_000 (4/6 frames)"]


def test_a_line_of_the_work_itself_is_one(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    times = iter([0.0, 9.0, 9.5, 18.9, 19.6, 19.7])
    monkeypatch.setattr("nte.progress.time.monotonic", lambda: next(times))
    with Progress("train mine", 9, "step", done=4) as progress:
        progress.told()
        for _ in range(3):
            progress.advance(1)
    assert capsys.readouterr().err == "train mine (7/9 steps)\n"


def test_silence_is_silent(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("nte.progress.INTERVAL", 0)
    with Progress("render", 2, "frame", shown=False) as progress:
        progress.advance(2)
        progress.say("done")
    assert capsys.readouterr().err == ""
