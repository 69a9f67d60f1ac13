"""Benchmarks on the command line: help from the docstring, and one line for bad input."""

import runpy
import sys
from pathlib import Path

import pytest

import benchmarks

FOLDER = Path(benchmarks.__file__).parent
COMMANDS = sorted(path.stem for path in FOLDER.glob("*.py") if "__main__" in path.read_text(encoding="utf-8"))
EXTRAS = {"correspondence": ("cv2", "gefolki")}  # what a benchmark compares with


@pytest.mark.parametrize("name", COMMANDS)
@pytest.mark.filterwarnings("ignore:.*found in sys.modules.*:RuntimeWarning")
def test_every_benchmark_has_a_help_and_refuses_nonsense_in_one_line(
    name: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    for package in EXTRAS.get(name, ()):
        pytest.importorskip(package)
    monkeypatch.chdir(tmp_path)

    def run(argument: str) -> int:
        monkeypatch.setattr(sys, "argv", [str(FOLDER / f"{name}.py"), argument])
        with pytest.raises(SystemExit) as ended:
            runpy.run_module(f"benchmarks.{name}", run_name="__main__")
        return int(ended.value.code)  # type: ignore[arg-type]

    assert run("--help") == 0
    assert f"usage: benchmarks.{name}" in capsys.readouterr().out
    assert run("nonsense") == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith(f"benchmarks.{name}: ")
    assert len(err.splitlines()) == 1


@pytest.mark.parametrize(
    ("name", "arguments", "said"),
    [
        ("burst", "--size wide", "'wide' is no size: expected WIDTHxHEIGHT"),
        ("components", "128 -1", "-1"),
        ("kernels", "--batch 0", "'0': expected a whole number, 1 or more"),
        ("motion_blur", "nowhere", "nowhere/recipe.yaml: No such file or directory"),
    ],
)
@pytest.mark.filterwarnings("ignore:.*found in sys.modules.*:RuntimeWarning")
def test_what_was_wrong_is_said(
    name: str, arguments: str, said: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", [str(FOLDER / f"{name}.py"), *arguments.split()])
    with pytest.raises(SystemExit) as ended:
        runpy.run_module(f"benchmarks.{name}", run_name="__main__")
    assert ended.value.code == 2
    assert said in capsys.readouterr().err
