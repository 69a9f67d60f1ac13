"""What the tests of faults compare: everything but what no two runs share."""

import json
from pathlib import Path

import numpy as np
import pytest

from nte.evaluation.metric_table import METRICS, format_table
from nte.evaluation.report.files import csv_rows, latex_tables
from nte.evaluation.table_files import write_tables
from nte.viewer.page import write_page
from tests.faults.commands import contents, differing


def results(folder: Path, milliseconds: float = 1.2, psnr: float = 30.0, **more: str) -> Path:
    """The files of an evaluation and of a comparison. more: what else there is of a clip."""
    metrics = {
        "rows": [{"clip": "a", "denoiser": "taa", "psnr": psnr, "ms_per_frame": milliseconds} | more],
        "means": {"taa": {one.name: milliseconds if one.name == "ms_per_frame" else psnr for one in METRICS}},
    }
    folder.mkdir()
    (folder / "metrics.json").write_text(json.dumps(metrics))
    cells = {"psnr": [psnr, None, None], "ms_per_frame": [milliseconds, milliseconds - 1, milliseconds + 1]}
    best = {metric: [] for metric in cells}
    tables = [{"region": "all", "light": "", "rows": {"taa": cells}, "best": best}]
    write_tables(folder, csv_rows(tables), latex_tables(tables))
    write_page(folder, {"title": "a", "rows": metrics["rows"], "tables": tables}, format_table(metrics))
    text = np.frombuffer(json.dumps(metrics).encode(), np.uint8)
    np.savez_compressed(folder / "a.npz", about=text, image=np.full(3, psnr))
    return folder


@pytest.mark.parametrize("more", [{}, {"settings": "alpha=0.1"}])
def test_times_are_masked_and_nothing_else(more: dict[str, str], tmp_path: Path) -> None:
    expected = contents(results(tmp_path / "undisturbed", **more))
    assert not differing(contents(results(tmp_path / "slower", milliseconds=1234.5, **more)), expected)
    numbers = contents(results(tmp_path / "other numbers", psnr=30.1, **more))
    settings = contents(results(tmp_path / "other", settings="alpha=0.2"))  # which tables do not state
    for found, same in ((numbers, []), (settings, ["tables.csv", "tables.tex"])):
        assert found.keys() == expected.keys()
        assert sorted(name for name in found if found[name] == expected[name]) == same


@pytest.mark.parametrize("more", ["nothing in it/", ".a.npz.0123.tmp", "layers/0000.js"])
def test_nothing_else_may_be_there(more: str, tmp_path: Path) -> None:
    expected = contents(results(tmp_path / "undisturbed"))
    path = results(tmp_path / "more") / more
    (path if more.endswith("/") else path.parent).mkdir(parents=True, exist_ok=True)
    if not more.endswith("/"):
        path.touch()
    assert contents(tmp_path / "more") != expected
