"""History of the recorded figures, run after run: python -m benchmarks.history [FIGURE]

Without FIGURE, prints the last value of each figure. With FIGURE, prints every run of all figures whose names contain
it, per machine.
"""

from collections.abc import Sequence
from pathlib import Path

from benchmarks.command import make_parser, run
from benchmarks.record import RESULTS, Figure, read
from nte.errors import NteError
from nte.text_table import aligned


def history(figures: Sequence[Figure], wanted: str | None) -> str:
    """Format the wanted figures as a table, or the last value of each figure if `wanted` is None.

    figures: ordered by date.
    """
    if wanted is None:
        chosen = list({(figure.name, figure.machine): figure for figure in figures}.values())
    else:
        chosen = [figure for figure in figures if wanted.lower() in figure.name.lower()]
    chosen.sort(key=lambda figure: (figure.machine, figure.name, figure.date))
    columns = [
        ["figure", *(figure.name for figure in chosen)],
        ["value", *(f"{figure.value:.4g} {figure.unit}".strip() for figure in chosen)],
        ["commit", *(figure.commit for figure in chosen)],
        ["date", *(figure.date[:10] for figure in chosen)],
        ["machine", *(figure.machine for figure in chosen)],
    ]
    return aligned(columns)


def main(arguments: Sequence[str], folder: Path = RESULTS) -> None:
    """Print the table. Raises NteError if no figure has that name."""
    parser = make_parser(__doc__)
    parser.add_argument("figure", nargs="?", help="part of a figure's name")
    wanted = parser.parse_args(arguments).figure
    figures = read(folder)
    if not any(wanted is None or wanted.lower() in figure.name.lower() for figure in figures):
        known = ", ".join(sorted({figure.name for figure in figures}))
        raise NteError(
            f"no figure is called {wanted!r}: there is {known}" if known else "no figure is kept yet: run make bench"
        )
    print(history(figures, wanted))


if __name__ == "__main__":
    run(main)
