"""The results of a comparison: a report for each situation, summary.json, tables as text and plots."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

from nte.evaluation.comparison.clips import matching_clips
from nte.evaluation.comparison.numbers import Evaluated, Method, Selection, part_of
from nte.evaluation.comparison.planned import Planned, unit_name
from nte.evaluation.comparison.plot import write_plot
from nte.evaluation.comparison.schema import Columns, Comparison, Plot, Table
from nte.evaluation.comparison.text import csv_rows, latex_tables, markdown
from nte.evaluation.metric_table import Row
from nte.evaluation.report.page import write_report
from nte.evaluation.report.strips import write_strips
from nte.evaluation.results import Evaluation, gathered, means_of
from nte.evaluation.table_files import write_tables
from nte.evaluation.units import ClipScores
from nte.files import make_folder, write_whole
from nte.viewer.page import clear

FORMAT = "nte-comparison/2"
Failures = list[Row]


def write_results(
    comparison: Comparison,
    planned: Sequence[Planned],
    scores: Mapping[str, ClipScores],
    failures: Failures,
    data: Path,
    out: Path,
) -> Row:
    """Write everything that comes out of a comparison, and return the content of summary.json.

    <situation>/ gets metrics.json, index.html (tables, plots over time, pictures) and strips/; of a network, the page
    shows the first seed. summary.json has the numbers of all tables, tables.md, tables.tex and tables.csv the same as
    text, <plot>.svg the plots.
    """
    found = {}
    for plan in planned:
        evaluation = gathered([scores[unit_name(plan.situation, label)] for label in plan.clips])
        _write_situation(plan, evaluation, out / plan.situation.name)
        found[plan.situation.name] = plan, Evaluated(evaluation.metrics["rows"])
    tables = [_table(comparison, table, *found[table.situation], data) for table in comparison.tables]
    summary = {"format": FORMAT, "tables": tables, "failures": failures}
    text = json.dumps(summary, indent=1, allow_nan=False) + "\n"
    write_whole(out / "summary.json", lambda temporary: temporary.write_text(text, encoding="utf-8"))
    write_whole(out / "tables.md", lambda temporary: temporary.write_text(markdown(summary), encoding="utf-8"))
    write_tables(out, csv_rows(summary), latex_tables(summary))
    for plot in comparison.plots:
        _plot(plot, *found[plot.situation], data, out / f"{plot.name}.svg")
    return summary


def _write_situation(plan: Planned, evaluation: Evaluation, folder: Path) -> None:
    make_folder(folder)
    evaluation.write(folder)
    titles = {method.title: method.specs[0] for method in plan.methods if method.specs}
    rows = [row for row in evaluation.metrics["rows"] if row["denoiser"] in titles.values()]
    if not rows:
        return
    shown = [one.only(titles.values()) for one in evaluation.shown]
    shown = [one for one in shown if one.flip]
    page = Evaluation({**evaluation.metrics, "rows": rows, "means": means_of(rows)}, shown).titled(titles)
    clear(folder)
    write_report(page, folder, titles)
    write_strips(page.shown, folder / "strips")


def _table(comparison: Comparison, table: Table, plan: Planned, found: Evaluated, data: Path) -> Row:
    """The numbers of a table, as they stand in summary.json."""
    methods = _methods(plan, table.methods)
    against = next((method for method in plan.methods if method.title == table.against), None)
    chosen = [_selection(plan, part, table.name, data) for part in table.columns]
    rows = [
        {
            "method": method.title,
            "label": _label(comparison, plan, method),
            "denoisers": list(method.specs),
            "seeds": list(method.seeds),
            "parts": [
                part_of(found, method, selection, part.metrics, part.margins, against)
                for part, selection in zip(table.columns, chosen, strict=True)
            ],
        }
        for method in methods
    ]
    columns = [
        {"title": selection.title, "clips": len(selection.clips), "metrics": part.metrics, "margins": part.margins}
        for part, selection in zip(table.columns, chosen, strict=True)
    ]
    about = {"name": table.name, "situation": table.situation, "caption": table.caption, "against": table.against}
    return {**about, "columns": columns, "rows": rows}


def _methods(plan: Planned, titles: Sequence[str]) -> list[Method]:
    by_title = {method.title: method for method in plan.methods}
    return [by_title[title] for title in titles or by_title]


def _label(comparison: Comparison, plan: Planned, method: Method) -> str:
    """The method's title, with the number of its seeds if it is trained."""
    network = plan.situation.runs.get(method.title)
    if network is None:
        return method.title
    asked, found = len(comparison.seeds_of(network)), len(method.seeds)
    if found < asked:
        return f"{method.title} ({found} of {asked} seeds)"
    return f"{method.title} ({asked} seed{'s' if asked > 1 else ''})"


def _selection(plan: Planned, part: Columns | Plot, name: str, data: Path) -> Selection:
    patterns = [part.clip] if isinstance(part, Plot) else part.clips
    folders = matching_clips(patterns, data, f"'{name}'") if patterns else list(plan.clips.values())
    labels = tuple(label for label, folder in plan.clips.items() if folder in folders)
    light = part.light or plan.situation.light
    title = "" if isinstance(part, Plot) else part.title
    first = plan.situation.first if part.first is None else part.first
    assert first is not None
    return Selection(title or f"{light}, {part.region}", labels, light, part.region, first)


def _plot(plot: Plot, plan: Planned, found: Evaluated, data: Path, path: Path) -> None:
    chosen = _selection(plan, plot, plot.name, data)
    if chosen.clips:  # a clip that failed has nothing to draw
        write_plot(path, found, _methods(plan, plot.methods), chosen, plot.metrics)
