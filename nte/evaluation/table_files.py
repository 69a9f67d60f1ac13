"""Tables as files: CSV with all digits, for programs; LaTeX (booktabs) with the digits of the page, for papers."""

import csv
import io
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from nte.evaluation.metric_table import Row
from nte.files import write_whole

CSV, LATEX = "tables.csv", "tables.tex"
_NEEDS = r"% \usepackage{booktabs}"
_LATEX = str.maketrans({
    **{sign: f"\\{sign}" for sign in "&%$#_{}"},
    "\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}",
    "<": r"\textless{}", ">": r"\textgreater{}", "|": r"\textbar{}",
    "[": "{[}", "*": "{*}",  # after the end of a line they would be its options
    "−": "$-$", "–": "--", "…": r"\dots{}", "↑": r"$\uparrow$", "↓": r"$\downarrow$",
})  # fmt: skip


@dataclass(frozen=True)
class LatexTable:
    """A table whose cells are LaTeX. title: what a comment above it says. rows: the first cell is the line's name."""

    title: str
    heads: Sequence[str]
    rows: Sequence[Sequence[str]]

    def text(self) -> str:
        """Return a tabular; the first column is aligned to the left, all others to the right."""
        lines = [" & ".join(cells) + r" \\" for cells in (self.heads, *self.rows)]
        columns = "l" + "r" * (len(self.heads) - 1)
        begin, end = rf"\begin{{tabular}}{{{columns}}}", r"\end{tabular}"
        comment = f"% {' '.join(self.title.split())}"
        return "\n".join([comment, begin, r"\toprule", lines[0], r"\midrule", *lines[1:], r"\bottomrule", end])


def latex(text: str) -> str:
    """Write any text, such as a denoiser's name, so that LaTeX prints it."""
    return text.translate(_LATEX)


def latex_number(text: str, best: bool = False) -> str:
    """Write numbers as a table has them so that LaTeX prints them: a hyphen is a minus, and the best is bold."""
    number = latex(text.replace("-", "−"))
    return rf"\textbf{{{number}}}" if best else number


def write_tables(out: Path, rows: Iterable[Row], tables: Iterable[LatexTable]) -> None:
    """Write `out`/tables.csv and `out`/tables.tex.

    rows: lines of the CSV, column → value; a column that a row lacks, or None, is left empty. Raises NteError if a
    file cannot be written.
    """
    as_csv, as_latex = _csv(list(rows)), "\n\n".join([_NEEDS, *(table.text() for table in tables)]) + "\n"
    write_whole(out / CSV, lambda temporary: temporary.write_text(as_csv, encoding="utf-8", newline=""))
    write_whole(out / LATEX, lambda temporary: temporary.write_text(as_latex, encoding="utf-8"))


def _csv(rows: Sequence[Row]) -> str:
    text = io.StringIO()
    table = csv.DictWriter(text, list(dict.fromkeys(key for row in rows for key in row)), lineterminator="\n")
    table.writeheader()
    table.writerows(rows)
    return text.getvalue()
