"""The benchmark for GPUs, on the CPU: every row has its steps, what cannot run says why, one may keep the figures."""

import shutil
from pathlib import Path

import pytest

from benchmarks import gpu
from benchmarks.record import read
from nte.errors import NteError

CONFIG = Path(gpu.__file__).parents[1] / "configs" / "quickstart.yaml"
STEPS = {"reading", "carrying", "reprojection", "prediction", "kernels", "blending"}


@pytest.mark.slow
def test_every_row_is_measured(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(gpu, "BACKEND", "eager")  # which traces, and needs no compiler
    shutil.copy(CONFIG, tmp_path / "mine.yaml")
    figures = tmp_path / "figures"
    words = [str(tmp_path / "mine.yaml"), "--device", "cpu", "--size", "64x48", "--frames", "2"]
    gpu.main([*words, "--results", str(figures)])
    said = capsys.readouterr().out
    assert "not measured" not in said
    found: dict[str, dict[str, float]] = {}
    for figure in read(figures):
        name, _, step = figure.name.removeprefix("gpu: ").rpartition(", 64x48, cpu, ")
        found.setdefault(name, {})[step] = figure.value
        assert figure.unit == "ms"
        assert figure.value > 0
    ways = ["float32", "bfloat16", "compiled, float32", "compiled, bfloat16"]
    assert list(found) == [*(f"mine, {way}" for way in ways), "svgf", "trmv", "correspondence"]
    for way in ways:
        assert found[f"mine, {way}"].keys() == {"frame", *STEPS}
    assert "svgf: à-trous" in found["svgf"]
    assert found["correspondence"].keys() == {"frame"}


def test_what_cannot_run_says_why_and_the_rest_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(gpu, "FILTERS", ("noisy",))

    def no_memory(*_: object) -> dict[str, float]:
        raise RuntimeError("out of memory\nTried to allocate 9 GB")

    monkeypatch.setattr(gpu, "measure_search", no_memory)
    (tmp_path / "mine.onnx").write_text("no model")
    words = [str(tmp_path / "mine.onnx"), "--device", "cpu", "--size", "32x24", "--frames", "1"]
    gpu.main([*words, "--results", str(tmp_path / "figures")])
    lines = capsys.readouterr().out.splitlines()[1:]
    assert lines[0].startswith("mine in ONNX Runtime, 32x24: not measured: ")
    assert lines[1].startswith("noisy, 32x24: 0.")
    assert lines[2] == "correspondence, 32x24: not measured: out of memory"
    assert len(read(tmp_path / "figures")) == 1


def test_no_file_is_written_unless_a_folder_is_given(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gpu, "FILTERS", ("noisy",))
    before = read()
    gpu.main(["--device", "cpu", "--size", "32x24", "--frames", "1"])
    assert read() == before


def test_sources_and_devices_that_are_not_there_are_told(tmp_path: Path) -> None:
    for source, message in ((tmp_path / "none", "none: does not exist"), (tmp_path, "expected a run folder")):
        with pytest.raises(NteError, match=message):
            gpu.main([str(source), "--device", "cpu"])
    with pytest.raises(NteError, match="--device teapot"):
        gpu.main(["--device", "teapot"])
