"""The subcommand `nte compare`."""

import argparse
from pathlib import Path

from nte.cli.parsing import Commands, add_device, add_force, command


def add(commands: Commands) -> None:
    """Add `compare` to the subcommands of `nte`."""
    text = "reproduce a published comparison: render, evaluate, report"
    parser = command(commands, "compare", _compare, text, "eval")
    parser.add_argument("comparison", type=Path, metavar="COMPARISON.yaml", help="a recipe and situations with methods")
    parser.add_argument("--data", type=Path, required=True, help="folder for the rendered clips; continues there")
    parser.add_argument("--out", type=Path, required=True, help="folder for the reports")
    parser.add_argument("--jobs", type=int, default=1, help="situations evaluated at the same time (default: 1)")
    add_device(parser)
    add_force(parser)


def _compare(options: argparse.Namespace) -> None:
    from nte.evaluation.paper_comparison import read_comparison, run_comparison, summary_table
    from nte.progress import Progress
    from nte.render.recipes.clips import render_recipe

    comparison = read_comparison(options.comparison)
    render_recipe(comparison.recipe, options.data)
    with Progress("compare", 0, "frame") as progress:
        rows = run_comparison(
            comparison, options.data, options.out, options.force, options.device, progress.reach, options.jobs
        )
    print(summary_table(rows))
    print(f"reports: {options.out}")
