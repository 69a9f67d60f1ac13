"""Prints the options of every denoiser that has a name as Markdown tables, from their classes.

--write puts them into docs/denoisers.md, below the marks `<!-- options: NAME -->`.
"""

import re
from collections.abc import Sequence
from dataclasses import Field, fields
from pathlib import Path
from typing import Any

from benchmarks.command import make_parser, run
from nte.filters.estimated import EstimateOptions
from nte.filters.named import NAMES, filter_type
from nte.options import Options, rules_of

PAGE = Path(__file__).parents[1] / "docs" / "denoisers.md"
MARK = re.compile(r"<!-- options: (\w+) -->\n(.*?)<!-- end -->\n", re.DOTALL)


def main(argv: Sequence[str]) -> int:
    parser = make_parser(__doc__)
    parser.add_argument("--write", action="store_true", help="write the tables into the page")
    if parser.parse_args(argv).write:
        PAGE.write_text(updated(PAGE.read_text("utf-8")), "utf-8")
    else:
        print("\n".join(f"{name}\n\n{table(kind)}" for name, kind in options_classes().items()))
    return 0


def options_classes() -> dict[str, type[Options]]:
    """Return the options class of each name, with `estimate`, which wraps any denoiser."""
    return {**{name: filter_type(name).options_type for name in NAMES}, "estimate": EstimateOptions}


def updated(page: str) -> str:
    """Return the text of the page with the tables as the classes have them now."""
    kinds = options_classes()
    return MARK.sub(lambda mark: f"<!-- options: {mark[1]} -->\n\n{table(kinds[mark[1]])}\n<!-- end -->\n", page)


def table(kind: type[Options]) -> str:
    """Return a line for each option: name, default, what it may be, what it means; then the presets.

    Options that share their meaning share a line. Those of another denoiser, unchanged, are left out.
    """
    rules, told = rules_of(kind), meanings(kind)
    above = kind.__mro__[1]
    inherited = (
        {(field.name, field.default) for field in fields(above)} if above in options_classes().values() else set()
    )
    rows: dict[tuple[str, str], list[Field[Any]]] = {}  # (values, meaning) → options
    for field in fields(kind):
        if (field.name, field.default) not in inherited:
            choices = ", ".join(f"`{choice}`" for choice in rules[field.name].choices)
            rows.setdefault((choices or rules[field.name].expected, told[field.name]), []).append(field)
    lines = ["| option | default | values | |", "|---|---|---|---|"]
    for (values, meaning), group in rows.items():
        names = ", ".join(f"`{field.name}`" for field in group)
        defaults = ", ".join(f"`{typed(field.default)}`" if field.default != () else "" for field in group)
        lines.append(f"| {names} | {defaults} | {values} | {meaning} |")
    for preset, changes in kind.presets.items():
        sets = ", ".join(f"`{name}={typed(value)}`" for name, value in changes.items())
        lines.append(f"| `preset={preset}` | | | {sets} |")
    return "\n".join([*lines, ""])


def typed(value: object) -> str:
    """Return a value as it is typed in a specification."""
    if value is None or isinstance(value, bool):
        return "auto" if value is None else str(value).lower()
    if isinstance(value, tuple):
        return "-".join(map(str, value))
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def meanings(kind: type[Options]) -> dict[str, str]:
    """Return what the docstrings of a class and its bases say of each option: `name, name: text.`"""
    names = "|".join(field.name for field in fields(kind))
    entry = re.compile(rf"(?:^|(?<=\. ))((?:{names})(?:, (?:{names}))*): ")
    found: dict[str, str] = {}
    for base in reversed(kind.__mro__):
        paragraphs = " ".join((base.__doc__ or "").split()) if issubclass(base, Options) and base is not Options else ""
        _, *parts = entry.split(paragraphs)
        for keys, text in zip(parts[::2], parts[1::2], strict=True):
            found |= dict.fromkeys(keys.split(", "), text.strip().rstrip(".").replace("|", "\\|"))
    return found


if __name__ == "__main__":
    run(main)
