"""The tables of a comparison as text: aligned for terminals, in Markdown for pages, in LaTeX and CSV for papers."""

from collections.abc import Iterator
from typing import NamedTuple, TypeAlias

from nte.evaluation.metric_table import METRICS, Metric, Row, best_of
from nte.evaluation.table_files import LatexTable, latex, latex_number
from nte.text_table import aligned

_METRICS = {metric.name: metric for metric in METRICS}
Summary: TypeAlias = Row  # the content of summary.json, or of one of its tables


class _Column(NamedTuple):
    heading: str
    cells: list[str]  # one for each line
    best: list[bool]


def plain(summary: Summary) -> str:
    """Format all tables as aligned text; * marks the best of each column, and failures follow."""
    blocks = []
    for table in summary["tables"]:
        columns = [[_heading(table), *(row["label"] for row in table["rows"])]]
        for heading, cells, best in _columns(table):
            marked = [cell + ("*" if is_best else " ") for cell, is_best in zip(cells, best, strict=True)]
            columns.append([f"{heading} ", *marked])
        blocks.append("\n".join([*([table["caption"]] if table["caption"] else []), aligned(columns)]))
    return "\n\n".join([*blocks, *(["\n".join(failure_lines(summary))] if summary["failures"] else [])])


def markdown(summary: Summary) -> str:
    """Format all tables in Markdown, each below a heading; the best of each column is bold, and failures follow."""
    blocks = []
    for table in summary["tables"]:
        columns = _columns(table)
        heads = [_heading(table), *(column.heading for column in columns)]
        lines = [f"### {table['name']}", "", *([table["caption"], ""] if table["caption"] else [])]
        lines += [_line(heads), _line(["---", *["---:"] * len(columns)])]
        for number, row in enumerate(table["rows"]):
            cells = [f"**{c.cells[number]}**" if c.best[number] else c.cells[number] for c in columns]
            lines.append(_line([row["label"], *cells]))
        blocks.append("\n".join(lines))
    failures = [f"- {line}" for line in failure_lines(summary)]
    return "\n\n".join([*blocks, *(["\n".join(["### Failures", "", *failures])] if failures else [])]) + "\n"


def latex_tables(summary: Summary) -> list[LatexTable]:
    """Make all tables in LaTeX; the best of each column is bold."""
    found = []
    for table in summary["tables"]:
        columns = _columns(table)
        heads = [latex(head) for head in (_heading(table), *(column.heading for column in columns))]
        rows = [
            [latex(row["label"]), *(latex_number(c.cells[number], c.best[number]) for c in columns)]
            for number, row in enumerate(table["rows"])
        ]
        found.append(LatexTable(f"{table['name']}: {table['caption']}".removesuffix(": "), heads, rows))
    return found


def csv_rows(summary: Summary) -> list[Row]:
    """Make the lines of the CSV: one for each method in each part of a table, with the number of clips of each metric.

    NAME_margin is the difference from the method `against`, NAME_margin_low and NAME_margin_high its interval.
    """
    return [
        {
            "table": table["name"], "part": part["title"], "light": numbers["light"], "region": numbers["region"],
            "first": numbers["first"], "method": row["method"], "seeds": len(row["seeds"]) or None,
            "against": table["against"] or None, **_numbers(numbers),
        }
        for table in summary["tables"]
        for number, part in enumerate(table["columns"])
        for row in table["rows"]
        for numbers in [row["parts"][number]]
    ]  # fmt: skip


def _numbers(part: Summary) -> Row:
    found: Row = {}
    for name, mean in part["metrics"].items():
        found |= {name: mean, f"{name}_clips": part["counted"][name]}
    for name, margin in part.get("margins", {}).items():
        if margin is not None:
            ends = {f"{name}_margin_{key}": margin[key] for key in ("low", "high", "clips")}
            found |= {f"{name}_margin": margin["mean"], **ends}
    return found


def failure_lines(summary: Summary) -> list[str]:
    """Say in one line each what failed."""
    lines = []
    for failure in summary["failures"]:
        who = failure["method"] or f"clip {failure['clip']}"
        who += "" if failure["seed"] is None else f", seed {failure['seed']}"
        where = f" in {failure['situation']}" if failure["situation"] else ""
        lines.append(f"{who} failed{where}: {failure['what']}")
    return lines


def _heading(table: Summary) -> str:
    """The heading of the first column: the table's name, and the number of clips if all parts have the same."""
    counts = {part["clips"] for part in table["columns"]}
    return f"{table['name']}, {_clips(counts.pop())}" if len(counts) == 1 else str(table["name"])


def _clips(count: int) -> str:
    return f"{count} clip{'' if count == 1 else 's'}"


def _columns(table: Summary) -> list[_Column]:
    several = len({part["clips"] for part in table["columns"]}) > 1
    found = []
    for number, part in enumerate(table["columns"]):
        where = f"{part['title']}, {_clips(part['clips'])}" if several else part["title"]
        parts = {row["method"]: row["parts"][number] for row in table["rows"]}
        found += [_metric(_METRICS[name], where, parts) for name in part["metrics"]]
        found += list(_margins(table, part, where, parts))
    return found


def _metric(metric: Metric, where: str, parts: Row) -> _Column:
    means = {method: part["metrics"] for method, part in parts.items()}
    best = best_of(means, metric)
    cells = [_mean(metric, part) for part in parts.values()]
    return _Column(f"{where}: {metric.label}", cells, [method in best for method in means])


def _margins(table: Summary, part: Summary, where: str, parts: Row) -> Iterator[_Column]:
    for name in part["margins"]:
        metric = _METRICS[name]
        cells = [_margin(metric, numbers) for numbers in parts.values()]
        heading = f"{where}: {metric.label} − {table['against']}'s, 95 % interval"
        yield _Column(heading, cells, [False] * len(cells))


def _mean(metric: Metric, part: Summary) -> str:
    mean = part["metrics"][metric.name]
    return metric.text(mean) + ("" if mean is None else _of_fewer(part["counted"][metric.name], part))


def _of_fewer(counted: int, part: Summary) -> str:
    """The number of clips that a number is of, if it is not that of the heading: some clips lack a number."""
    return "" if counted == part["clips"] else f", {_clips(counted)}"


def _margin(metric: Metric, part: Summary) -> str:
    margin = part.get("margins", {}).get(metric.name)
    if margin is None:
        return "–"
    mean, low, high = (f"{margin[key]:+.{metric.digits}f}" for key in ("mean", "low", "high"))
    interval = "" if margin["clips"] == 1 else f" ({low} … {high})"  # a single clip has none
    return mean + interval + _of_fewer(margin["clips"], part)


def _line(cells: list[str]) -> str:
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"
