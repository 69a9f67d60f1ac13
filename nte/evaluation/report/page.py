"""The report: a page of the viewer with the tables, curves and pictures of an evaluation."""

from collections.abc import Mapping
from pathlib import Path

from nte.evaluation.metric_table import Row, format_table
from nte.evaluation.report.files import csv_rows, latex_tables
from nte.evaluation.report.how import how_it_is_computed
from nte.evaluation.report.numbers import metric_table, tables
from nte.evaluation.report.pictures import picture_clips
from nte.evaluation.results import Evaluation
from nte.evaluation.table_files import write_tables
from nte.viewer.page import write_page

_CHOSEN = (
    "The frames of a clip that play are those around the one with the most disoccluded pixels, the last of several: "
    "the data choose them, not the results."
)


def write_report(evaluation: Evaluation, out: Path, methods: Mapping[str, str] | None = None) -> Path:
    """Write `out`/index.html, which needs neither network nor server, and return its path.

    Clips that were recorded play; of the others, the pictures that the evaluation has are written to `out`/layers.
    The tables of the page are written to `out`/tables.csv and `out`/tables.tex as well.
    methods: title → spec, if the evaluation's denoisers have titles. Raises NteError if a file cannot be written.
    """
    recorded = {entry["name"] for entry in evaluation.recorded}
    pictures = picture_clips([one for one in evaluation.shown if one.clip not in recorded], out)
    data = report_data(evaluation, methods, [*evaluation.recorded, *pictures])
    write_tables(out, csv_rows(data["tables"]), latex_tables(data["tables"]))
    return write_page(out, data, format_table(evaluation.metrics))


def report_data(evaluation: Evaluation, methods: Mapping[str, str] | None, clips: list[Row]) -> Row:
    """Collect what the viewer reads. clips: their entries, see `nte.viewer.recorder.Recorder.entry`."""
    rows = evaluation.metrics["rows"]
    return {
        "title": "Comparison of denoisers",
        "summary": _summary(evaluation.metrics),
        "notes": [],
        "note": _CHOSEN,
        "clips": clips,
        "rows": rows,
        "metrics": metric_table(),
        "tables": tables(rows),
        "about": how_it_is_computed(rows, methods),
    }


def _summary(metrics: Row) -> str:
    whole = [row for row in metrics["rows"] if row["region"] == "all"]
    frames = {row["clip"]: row["frames"] for row in whole}
    first = min((row["scored_from"] for row in whole), default=1)
    skipped = {0: "every frame of each clip", 1: "the first frame of each clip is skipped"}
    counts = (_count(len(metrics["means"]), "denoiser"), _count(len(frames), "clip"))
    how = skipped.get(first, f"frames before {first} are skipped")
    return f"{', '.join(counts)}, {sum(frames.values())} frames scored ({how})."


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"
