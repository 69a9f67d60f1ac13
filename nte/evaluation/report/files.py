"""The tables of a report's page as files: a line of the CSV for each denoiser, region and light; LaTeX tables."""

from nte.evaluation.metric_table import METRICS, Metric, Row
from nte.evaluation.table_files import LatexTable, latex, latex_number

_ARROWS = {"higher": " ↑", "lower": " ↓", "": ""}


def csv_rows(tables: list[Row]) -> list[Row]:
    """Make the lines of the CSV: each metric is followed by the interval, NAME_low and NAME_high.

    tables: those of the page, see `nte.evaluation.report.numbers.tables`.
    """
    return [
        {"region": table["region"], "light": table["light"], "denoiser": spec, **_numbers(cells)}
        for table in tables
        for spec, cells in table["rows"].items()
    ]


def latex_tables(tables: list[Row]) -> list[LatexTable]:
    """Make a LaTeX table of each table of the page; the best of each column is bold, intervals are in brackets."""
    return [_latex(table) for table in tables]


def _numbers(cells: Row) -> Row:
    ends = ("", "_low", "_high")
    return {f"{m}{end}": number for m, cell in cells.items() for end, number in zip(ends, cell, strict=True)}


def _latex(table: Row) -> LatexTable:
    metrics = [m for m in METRICS if any(m.name in cells for cells in table["rows"].values())]
    heads = ["Denoiser", *(f"{m.label}{_ARROWS[m.better]}" for m in metrics)]
    rows = [
        [latex(spec), *(_cell(m, cells[m.name], spec in table["best"][m.name]) for m in metrics)]
        for spec, cells in table["rows"].items()
    ]
    title = ", ".join(filter(None, (table["region"], table["light"])))
    return LatexTable(title, [latex(head) for head in heads], rows)


def _cell(metric: Metric, cell: list[float | None], best: bool) -> str:
    mean, low, high = (metric.text(number) for number in cell)
    interval = "" if cell[1] is None else latex_number(f" ({low} … {high})")
    return latex_number(mean, best) + interval
