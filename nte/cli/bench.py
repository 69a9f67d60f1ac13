"""The subcommand `nte bench`."""

import argparse
import json
from contextlib import ExitStack
from pathlib import Path

from nte.cli.parsing import DENOISER, Commands, add_device, add_force, add_provider, command, parse_size
from nte.errors import NteError


def add(commands: Commands) -> None:
    """Add `bench` to the subcommands of `nte`."""
    text = "time and memory of denoisers, which alternate frame by frame, each in a process of its own"
    parser = command(commands, "bench", _bench, text, "eval")
    parser.add_argument("specs", nargs="+", metavar="SPEC", help=DENOISER)
    size = "(default: 1280x720, or the clip's)"
    parser.add_argument("--size", nargs="+", type=parse_size, default=[], metavar="WIDTHxHEIGHT", help=size)
    parser.add_argument("--frames", type=int, default=10, help="timed frames, after a warm-up (default: 10)")
    threads = "numbers of CPU threads, each denoiser with each (default: as many as PyTorch takes)"
    parser.add_argument("--threads", nargs="+", type=int, default=[], metavar="N", help=threads)
    parser.add_argument("--clip", type=Path, help="frames to run on, scaled (default: synthetic ones)")
    parser.add_argument("--steps", action="store_true", help="also the time in each named step of a denoiser")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the results there")
    parser.add_argument("--plot", type=Path, metavar="FILE.svg", help="draw the quality of the clip against time")
    add_device(parser)
    add_provider(parser)
    add_force(parser)


def _bench(options: argparse.Namespace) -> None:
    from nte.evaluation.benchmark.bench import bench, require_quality, require_threads
    from nte.evaluation.benchmark.plot import write_plot
    from nte.files import write_whole
    from nte.registry import with_provider
    from nte.writers import only_writer_of

    if options.plot and options.plot.suffix != ".svg":
        raise NteError(f"--plot {options.plot}: expected a name that ends in .svg")
    written = [path for path in (options.json, options.plot) if path]
    for path in written:
        if not path.parent.is_dir():
            raise NteError(f"{path}: its folder does not exist")
    require_threads(options.threads)
    if options.plot:
        require_quality(options.clip, options.size)
    with ExitStack() as reserved:
        for path in written:
            reserved.enter_context(only_writer_of(path, options.force))
        specs = with_provider(options.specs, options.provider) if options.provider else options.specs
        results = bench(
            specs, options.size, options.frames, options.clip, options.device, options.steps, options.threads
        )
        print(results.text())
        if options.json:
            content = json.dumps(results.json(), indent=1)
            write_whole(options.json, lambda path: path.write_text(content + "\n"))
        if options.plot:
            write_plot(options.plot, results.rows)
