"""The subcommand `nte evaluate`."""

import argparse
from pathlib import Path

from nte.cli.parsing import DENOISER, Commands, add_device, add_force, add_jobs, command
from nte.evaluation.report import PLAYED


def add(commands: Commands) -> None:
    """Add `evaluate` to the subcommands of `nte`."""
    text = "compare denoisers on clips; writes metrics and a report"
    parser = command(commands, "evaluate", _evaluate, text, "eval")
    parser.add_argument("--clips", type=Path, nargs="+", required=True, help="clips, or folders of clips")
    parser.add_argument("--denoisers", nargs="+", required=True, metavar="SPEC", help=DENOISER)
    parser.add_argument("--out", type=Path, required=True, help="folder for metrics.json, index.html and tables")
    parser.add_argument("--first-frame", action="store_true", help="score the first frame too")
    text = f"frames of each clip that the report plays, around the one with most disoccluded pixels (default: {PLAYED})"
    parser.add_argument("--play", type=int, default=PLAYED, metavar="N", help=text)
    add_jobs(parser, "a clip")
    add_device(parser)
    add_force(parser)


def _evaluate(options: argparse.Namespace) -> None:
    from nte.evaluation.evaluate import evaluate
    from nte.evaluation.metric_table import format_table
    from nte.progress import Progress

    first = 0 if options.first_frame else 1
    with Progress("evaluate", 0, "frame") as progress:
        found = evaluate(
            options.clips, options.denoisers, options.out, first, force=options.force, device=options.device,
            progress=progress.reach, jobs=options.jobs, scheduler=options.scheduler, played=options.play,
        )  # fmt: skip
    print(format_table(found.metrics))
    print(f"report: {options.out / 'index.html'}")
