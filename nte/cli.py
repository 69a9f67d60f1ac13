"""The `nte` command. Every subcommand imports what it needs when it runs, so that `nte --help` is instant.

Exit status: 0 done; 2 wrong usage or input, told in one line; 1 a fault of ours; 130 interrupted.
"""

import argparse
import errno
import os
import sys
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NoReturn

from nte.errors import NteError, needs_extra
from nte.interrupt import terminable

_EXTRA_OF = {
    "render": "render", "train": "train", "export": "train", "evaluate": "eval", "compare": "eval", "check": "eval",
    "import": "import", "bench": "eval", "merge-burst": "burst", "estimate": "eval",
}  # fmt: skip
_OF_THE_SYSTEM = {
    errno.EACCES, errno.EPERM, errno.EROFS, errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.ENAMETOOLONG,
    errno.ELOOP, errno.EMFILE, errno.ENOTDIR, errno.EISDIR, errno.ESTALE,
}  # fmt: skip


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    parser = _parser()
    options, rest = parser.parse_known_args(argv)
    if hasattr(options, "overrides") and all("=" in item and item[0] != "-" for item in rest):
        options.overrides += rest  # argparse takes no more positionals after an option; users mix them
    elif rest:
        parser.error(f"unrecognised arguments: {' '.join(rest)}")
    warnings.showwarning = _tell_warning
    try:
        with terminable():
            return int(options.run(options) or 0)
    except NteError as error:
        print(f"nte: {error}", file=sys.stderr)
        return 2
    except ImportError as error:
        extra = _EXTRA_OF.get(options.command)
        if extra is None or (error.name or "").startswith("nte"):
            raise
        print(f"nte: {needs_extra(extra, f'nte {options.command}', error)}", file=sys.stderr)
        return 2
    except BrokenPipeError:  # nte check … | head: nobody reads on
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:  # not permitted, no space left, a name that is too long
        if error.errno not in _OF_THE_SYSTEM:
            raise
        print(f"nte: {f'{error.filename}: ' if error.filename else ''}{error.strerror}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("nte: interrupted; nothing half-written is left", file=sys.stderr)
        return 130


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        """Say what is wrong in one line, as for any other wrong input; the usage is a --help away."""
        self.exit(2, f"{self.prog}: error: {message}; see {self.prog} --help\n")


def _parser() -> argparse.ArgumentParser:
    from nte import __version__
    from nte.cli_bench import add_bench
    from nte.cli_burst import add_burst
    from nte.cli_estimate import add_estimate
    from nte.cli_import import add_import

    parser = _Parser(prog="nte", description="Neural temporal denoising of path-traced sequences")
    parser.add_argument("--version", action="version", version=f"nte {__version__}")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)

    render = _command(commands, "render", _render, "render the clips of a recipe with Mitsuba; resumes")
    render.add_argument("recipe", type=Path, metavar="RECIPE.yaml", help="what to render; datasets/README.md")
    render.add_argument("--out", type=Path, required=True, help="folder for the clips")
    where = render.add_mutually_exclusive_group()
    where.add_argument("--jobs", type=int, default=1, help="processes (one uses every core already)")
    where.add_argument("--scheduler", metavar="tcp://HOST:PORT", help="render on a Dask cluster that sees the folder")
    _force(render)

    train = _command(commands, "train", _train, "train a network; writes runs/<name>/")
    train.add_argument("config", type=Path, metavar="CONFIG.yaml", help="every choice; docs/training.md")
    train.add_argument("overrides", nargs="*", metavar="key=value", help="for example resume=true")
    _device(train, "auto")
    _force(train)

    evaluate = _command(commands, "evaluate", _evaluate, "compare denoisers on clips; writes metrics and a report")
    evaluate.add_argument("--clips", type=Path, nargs="+", required=True, help="clips, or folders of clips")
    evaluate.add_argument("--denoisers", nargs="+", required=True, metavar="SPEC", help="run, .onnx, or name:key=value")
    evaluate.add_argument("--out", type=Path, required=True, help="folder for metrics.json and index.html")
    evaluate.add_argument("--first-frame", action="store_true", help="score the first frame too")
    _device(evaluate, "cpu")
    _force(evaluate)

    compare = _command(commands, "compare", _compare, "reproduce a published comparison: render, evaluate, report")
    compare.add_argument("comparison", type=Path, metavar="COMPARISON.yaml", help="in configs/")
    compare.add_argument("--data", type=Path, required=True, help="folder for the rendered clips; continues there")
    compare.add_argument("--out", type=Path, required=True, help="folder for the reports")
    compare.add_argument("--jobs", type=int, default=1, help="situations evaluated at the same time (default: 1)")
    _device(compare, "cpu")
    _force(compare)

    export = _command(commands, "export", _export, "export a run as one ONNX file, checked against PyTorch")
    export.add_argument("source", type=Path, metavar="RUN", help="run folder, or a .safetensors file in one")
    export.add_argument("--out", type=Path, required=True, metavar="MODEL.onnx", help="file to write")
    _force(export)

    denoise = _command(commands, "denoise", _denoise, "denoise a clip or frames; writes linear OpenEXR")
    denoise.add_argument("sources", type=Path, nargs="+", metavar="CLIP_OR_FOLDER_OR_FILES")
    denoise.add_argument("--denoiser", required=True, metavar="SPEC", help="run, .onnx, or name:key=value")
    denoise.add_argument("--out", type=Path, required=True, help="folder for the frames")
    text = "estimate, or estimate:key=value,…: motion from the images, instead of given vectors"
    denoise.add_argument("--motion", metavar="estimate", help=text)
    text = "how to read another renderer's files: a channel map, or the name of one (default: the one that fits)"
    denoise.add_argument("--map", metavar="MAP", help=text)
    text = "a change to the map, such as view=left; repeat it for more"
    denoise.add_argument("--set", action="append", default=[], metavar="key=value", help=text)
    denoise.add_argument("--exposure", type=float, help="linear factor of the sequence (default: estimated once)")
    denoise.add_argument("--png", action="store_true", help="a tonemapped picture beside each frame")
    _device(denoise, "cpu")
    _force(denoise)

    add_estimate(commands)
    add_import(commands)
    add_bench(commands)
    add_burst(commands)

    check = _command(commands, "check", _check, "are the vectors and values of clips plausible? (exit 2: not)")
    check.add_argument("clips", type=Path, nargs="+", metavar="CLIP", help="clips, or folders of clips")
    check.add_argument("--picture", type=Path, metavar="FOLDER", help="draw motion, masks and residuals, a PNG a clip")
    _force(check)

    info = _command(commands, "info", _info, "describe a clip, a model or a run")
    info.add_argument("source", type=Path, metavar="CLIP|MODEL|RUN", help="folder, or .onnx file")
    return parser


def _command(commands: Any, name: str, run: Any, text: str) -> argparse.ArgumentParser:
    parser: argparse.ArgumentParser = commands.add_parser(name, help=text, description=text)
    parser.set_defaults(run=run)
    return parser


def _force(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--force", action="store_true", help="overwrite what exists")


def _device(parser: argparse.ArgumentParser, default: str) -> None:
    parser.add_argument("--device", default=default, help=f"cpu, cuda, … (default: {default})")


def _render(options: argparse.Namespace) -> None:
    from nte.render.recipes.clips import render_recipe

    folders = render_recipe(options.recipe, options.out, options.jobs, options.force, scheduler=options.scheduler)
    print(f"{len(folders)} clips in {options.out}")


def _train(options: argparse.Namespace) -> None:
    from nte.training.config import load_train_config
    from nte.training.loop import train

    print(train(load_train_config(options.config, options.overrides), options.force, options.device))


def _evaluate(options: argparse.Namespace) -> None:
    from nte.evaluation.compare import evaluate
    from nte.evaluation.report import write_report
    from nte.evaluation.table import format_table
    from nte.progress import Progress

    with Progress("evaluate", 0, "frame") as progress:
        found = evaluate(
            options.clips, options.denoisers, options.out, first=0 if options.first_frame else 1, force=options.force,
            device=options.device, progress=progress.reach,
        )  # fmt: skip
    page = write_report(found, options.out)
    print(format_table(found.metrics))
    print(f"report: {page}")


def _compare(options: argparse.Namespace) -> None:
    from nte.evaluation.comparison import read_comparison, run_comparison, summary_table
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


def _export(options: argparse.Namespace) -> None:
    from nte.files import only_writer_of
    from nte.runtime.export import export_onnx
    from nte.training.run import load_run

    with only_writer_of(options.out, options.force):
        export_onnx(load_run(options.source), options.out)
    print(options.out)


def _denoise(options: argparse.Namespace) -> None:
    from nte.registry import load_denoiser
    from nte.sequences import denoise_files

    if options.motion and options.motion.partition(":")[0] != "estimate":
        raise NteError(f"--motion {options.motion}: expected estimate, or estimate:key=value,…")
    spec = f"{options.motion}+{options.denoiser}" if options.motion else options.denoiser
    denoiser = load_denoiser(spec, options.device)
    written = denoise_files(
        options.sources, denoiser, options.out, options.exposure, options.png, options.force, options.map, options.set
    )
    print(f"{len(written)} frames in {options.out}")


def _check(options: argparse.Namespace) -> int:
    from nte.checking import check_clip, describe, draw
    from nte.files import make_folder, refuse_to_replace
    from nte.frames.clip import Clip, find_clips
    from nte.frames.show import write_png

    implausible = 0
    for folder in find_clips(options.clips):
        clip = Clip(folder)
        report = check_clip(clip)
        implausible += report.verdict == "implausible"
        print(describe(report))
        if options.picture and len(clip) > 1:
            path = options.picture / f"{'_'.join(folder.parts[-2:])}.png"
            refuse_to_replace((path,), options.force)
            make_folder(path.parent)
            write_png(path, draw(clip, report.telling_frame))
            print(f"  picture of frame {report.telling_frame}: {path}")
    return 2 if implausible else 0


def _info(options: argparse.Namespace) -> None:
    from nte.info import describe

    print(describe(options.source))


def _tell_warning(message: Warning | str, category: type[Warning], *_: object, **__: object) -> None:
    print(f"nte: warning: {message}", file=sys.stderr)
