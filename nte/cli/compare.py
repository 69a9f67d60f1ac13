"""The subcommand `nte compare`."""

import argparse
from functools import partial
from pathlib import Path

from nte.cli.parsing import Commands, add_device, add_force, add_jobs, command


def add(commands: Commands) -> None:
    """Add `compare` to the subcommands of `nte`."""
    text = "make a comparison: render, train, evaluate, report; goes on where it stopped (exit 2: something failed)"
    parser = command(commands, "compare", _compare, text, "eval")
    parser.add_argument(
        "comparison", type=Path, metavar="COMPARISON.yaml", help="recipes, networks, situations with methods, tables"
    )
    parser.add_argument("--data", type=Path, required=True, help="folder for the rendered clips; continues there")
    parser.add_argument("--out", type=Path, required=True, help="folder for the reports; continues there")
    text = "folder for the runs of its networks, in a folder of the comparison's name; continues there (default: runs)"
    parser.add_argument("--runs", type=Path, default=Path("runs"), help=text)
    add_jobs(parser, "a clip or a training")
    add_device(parser)
    add_force(parser, "evaluate everything anew, and replace another comparison's results (never runs or clips)")


def _compare(options: argparse.Namespace) -> int:
    from nte.evaluation.comparison.clips import is_used
    from nte.evaluation.comparison.read import read_comparison
    from nte.evaluation.comparison.run import check_methods, run_comparison
    from nte.evaluation.comparison.text import failure_lines, plain
    from nte.render.recipes.clips import render_recipe

    comparison = read_comparison(options.comparison)
    runs = options.runs / options.comparison.stem
    check_methods(comparison, options.data, runs, options.device)  # before an hour of rendering
    for folder, recipe in comparison.recipes.items():
        wanted = partial(is_used, comparison, folder)
        render_recipe(recipe, options.data / folder, options.jobs, scheduler=options.scheduler, wanted=wanted)
    summary = run_comparison(
        comparison, options.data, options.out, runs, options.force, options.device, options.jobs, options.scheduler
    )
    print(plain(summary))
    print(f"reports: {options.out}; tables: {options.out / 'tables.md'}, tables.tex, tables.csv")
    return 2 if failure_lines(summary) else 0
