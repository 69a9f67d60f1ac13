"""The subcommand `nte bench`."""

import argparse
import json
from contextlib import nullcontext
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
    parser.add_argument("--clip", type=Path, help="frames to run on, scaled (default: synthetic ones)")
    parser.add_argument("--steps", action="store_true", help="also the time in each named step of a denoiser")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the rows there")
    add_device(parser)
    add_provider(parser)
    add_force(parser)


def _bench(options: argparse.Namespace) -> None:
    from nte.evaluation.benchmark.bench import FORMAT, bench
    from nte.files import only_writer_of, write_whole
    from nte.registry import with_provider
    from nte.text_table import aligned

    if options.json and not options.json.parent.is_dir():
        raise NteError(f"{options.json}: its folder does not exist")
    specs = with_provider(options.specs, options.provider) if options.provider else options.specs
    with only_writer_of(options.json, options.force) if options.json else nullcontext():
        rows = bench(specs, options.size, options.frames, options.clip, options.device, options.steps)
        if options.json:
            content = json.dumps({"format": FORMAT, "rows": rows}, indent=1)
            write_whole(options.json, lambda path: path.write_text(content + "\n"))
    titles = ["denoiser", "size", "ms per frame", "p95", "peak MB", "PSNR"]
    cells = [
        [
            row["denoiser"], f"{row['width']}x{row['height']}", f"{row['ms_per_frame']:.1f}", f"{row['p95']:.1f}",
            f"{row['peak_mb']:.0f}", f"{row['psnr']:.2f}" if "psnr" in row else "",
        ]
        for row in rows
    ]  # fmt: skip
    print(aligned([list(column) for column in zip(titles, *cells, strict=True)]))
    for row in rows:
        for name, milliseconds in row.get("steps", {}).items():
            print(f"{row['denoiser']} {row['width']}x{row['height']}: {name} {milliseconds:.1f} ms")
