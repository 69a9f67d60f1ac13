"""Tables as CSV and LaTeX: read back, they are the numbers of the page and of summary.json."""

import csv
import re
from pathlib import Path

import pytest

from nte.denoiser import Noisy
from nte.evaluation.comparison.text import csv_rows, latex_tables
from nte.evaluation.evaluate import evaluate
from nte.evaluation.metric_table import METRICS
from nte.evaluation.table_files import write_tables
from nte.registry import load_denoiser
from tests.evaluation.conftest import noisy_frames
from tests.evaluation.test_comparison_tables import table_of
from tests.synthetic import write_clip
from tests.viewer.reading import data_of

NAME = r"a_b, 50% & c\d #1 {e} $f$ ~g^h <i|j>"
OPTION = "[x]*"  # at the beginning of a line, the one before would take it for its option
_LATEX = {
    "textbackslash{}": "\\", "textasciitilde{}": "~", "textasciicircum{}": "^", "textless{}": "<",
    "textgreater{}": ">", "textbar{}": "|", "dots{}": "…",
}  # fmt: skip


def printed(source: str) -> str:
    """What LaTeX prints of a cell."""
    source = re.sub(r"\\textbf\{((?:\$-\$|[^{}])*)\}", r"\1", source)
    source = re.sub(r"\{([\[*])\}", r"\1", source).replace("$-$", "-")
    source = source.replace(r"$\uparrow$", "↑").replace(r"$\downarrow$", "↓")
    names = "|".join(map(re.escape, _LATEX))
    return re.sub(rf"\\({names}|[&%$#_{{}}])", lambda found: _LATEX.get(found[1], found[1]), source)


def read_latex(path: Path) -> dict[str, list[list[str]]]:
    """Comment above → lines of cells, as printed."""
    found = {}
    text = path.read_text("utf-8")
    assert text.startswith("% \\usepackage{booktabs}\n")
    tabular = r"^% ([^\n]*)\n\\begin\{tabular\}\{(lr+)\}\n(.*?)\\end\{tabular\}$"
    parts = re.findall(tabular, text, re.DOTALL | re.MULTILINE)
    assert len(parts) == text.count(r"\begin{tabular}")
    for title, columns, inside in parts:
        lines = [line for line in inside.splitlines() if line not in (r"\toprule", r"\midrule", r"\bottomrule")]
        assert all(line.endswith(r" \\") and line[0] not in "[*" for line in lines)
        found[title] = [[printed(cell) for cell in re.split(r" (?<!\\)& ", line[:-3])] for line in lines]
        assert {len(line) for line in found[title]} == {len(columns)}
    return found


def read_csv(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("tables")
    clips = [write_clip(folder / f"clip {seed}", noisy_frames(3, seed)) for seed in range(2)]
    evaluate(clips, {NAME: load_denoiser("taa"), OPTION: Noisy()}, folder / "out")
    return folder / "out"


def test_the_csv_has_every_number_of_the_page(out: Path) -> None:
    page = data_of((out / "index.html").read_text("utf-8"))["tables"]
    lines = read_csv(out / "tables.csv")
    found = {(line["region"], line["light"], line["denoiser"]): line for line in lines}
    assert len(found) == len(lines) == sum(len(table["rows"]) for table in page)
    for table in page:
        for name, cells in table["rows"].items():
            line = found[table["region"], table["light"], name]
            for metric, cell in cells.items():
                read = [line[f"{metric}{end}"] for end in ("", "_low", "_high")]
                assert [float(number) if number else None for number in read] == cell
    assert {name for _, _, name in found} == {NAME, OPTION}


def test_the_latex_has_what_the_page_prints(out: Path) -> None:
    page = data_of((out / "index.html").read_text("utf-8"))["tables"]
    found = read_latex(out / "tables.tex")
    assert list(found) == [table["region"] for table in page]
    for table in page:
        (head, *lines), metrics = found[table["region"]], [m for m in METRICS if m.name in table["rows"][NAME]]
        arrows = {"higher": " ↑", "lower": " ↓", "": ""}
        assert head == ["Denoiser", *(m.label + arrows[m.better] for m in metrics)]
        assert [line[0] for line in lines] == [NAME, OPTION]
        for name, *cells in lines:
            for metric, cell in zip(metrics, cells, strict=True):
                mean, low, high = (metric.text(number) for number in table["rows"][name][metric.name])
                assert cell == f"{mean} ({low} … {high})"
    bold = sum(len(names) for table in page for names in table["best"].values())
    assert (out / "tables.tex").read_text("utf-8").count(r"\textbf") == bold > 0


def test_files_of_a_comparison_have_its_means_margins_and_counts(tmp_path: Path) -> None:
    scores = {"seed 1": [31.0, 32.0, None], "seed 2": [31.5, 32.0, 33.0], "filter": [30.0, 31.5, 33.0]}
    summary = table_of(scores)
    (table,) = summary["tables"]
    table["caption"] = "Of what\nmoves."
    write_tables(tmp_path, csv_rows(summary), latex_tables(summary))
    network, other = read_csv(tmp_path / "tables.csv")
    part = table["rows"][0]["parts"][0]
    margin = part["margins"]["psnr"]
    expected = {
        "psnr": part["metrics"]["psnr"], "psnr_clips": 2, "psnr_margin": margin["mean"], "first": 1,
        "psnr_margin_low": margin["low"], "psnr_margin_high": margin["high"], "psnr_margin_clips": 2, "seeds": 2,
    }  # fmt: skip
    assert {key: float(network[key]) for key in expected} == expected
    assert [network[key] for key in ("table", "part", "region", "method")] == ["both", "moving", "moving", "network"]
    assert (other["method"], other["psnr"], other["psnr_margin"], other["seeds"]) == ("filter", "31.5", "", "")
    found = read_latex(tmp_path / "tables.tex")
    ((head, ours, _),) = found.values()
    assert list(found) == ["both: Of what moves."]
    assert head == ["both, 3 clips", "moving: PSNR, dB", "moving: PSNR, dB - filter's, 95 % interval"]
    said = "{mean:+.2f} ({low:+.2f} … {high:+.2f}), 2 clips".format(**margin)
    assert ours == ["network", "31.62, 2 clips", said]
    assert margin["low"] < 0  # a minus that is no hyphen
    assert r"($-$" in (tmp_path / "tables.tex").read_text("utf-8")
