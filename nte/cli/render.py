"""The subcommand `nte render`."""

import argparse
from pathlib import Path

from nte.cli.parsing import Commands, add_force, add_jobs, command


def add(commands: Commands) -> None:
    """Add `render` to the subcommands of `nte`."""
    parser = command(commands, "render", _render, "render the clips of a recipe with Mitsuba; resumes", "render")
    parser.add_argument(
        "recipe", type=Path, metavar="RECIPE.yaml", help="what to render: scenes, sizes, samples, seeds"
    )
    parser.add_argument("--out", type=Path, required=True, help="folder for the clips")
    add_jobs(parser, "a clip")
    add_force(parser)


def _render(options: argparse.Namespace) -> None:
    from nte.render.recipes.clips import render_recipe

    folders = render_recipe(options.recipe, options.out, options.jobs, options.force, scheduler=options.scheduler)
    print(f"{len(folders)} clips in {options.out}")
