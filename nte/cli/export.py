"""The subcommand `nte export`."""

import argparse
from pathlib import Path

from nte.cli.parsing import Commands, add_force, command
from nte.errors import NteError


def add(commands: Commands) -> None:
    """Add `export` to the subcommands of `nte`."""
    text = "export a run as one ONNX file, checked against PyTorch; or one of a lower precision"
    parser = command(commands, "export", _export, text, "train")
    parser.add_argument(
        "source",
        type=Path,
        metavar="RUN",
        help="run folder, or a .safetensors file in one; or an .onnx file or a released model, which is copied",
    )
    parser.add_argument("--out", type=Path, required=True, metavar="MODEL.onnx", help="file to write")
    parser.add_argument(
        "--vectors", type=Path, metavar="FOLDER", help="write inputs and outputs of four frames there, to check ports"
    )
    text = "write the weights alone there, for a training's init_from"
    parser.add_argument("--weights", type=Path, metavar="FILE.safetensors", help=text)
    text = "copy an exported model with a network that computes in float16, or in bytes"
    parser.add_argument("--precision", choices=["f16", "int8"], help=text)
    text = "for int8: typical clips, such as some of the training, which tell how large values become"
    parser.add_argument("--calibrate", type=Path, nargs="+", default=[], metavar="CLIP", help=text)
    add_force(parser)


def _export(options: argparse.Namespace) -> None:
    from nte.registry import model_of

    if options.calibrate and not options.precision:
        raise NteError("--calibrate is for --precision int8: give both, or neither")
    if (model := model_of(str(options.source))) is not None and not model[1]:
        print(_copied(model[0], options))
        return
    if options.precision:
        raise NteError(f"{options.source}: is no exported model: export it first, and then that file with --precision")
    from nte.runtime.export import export

    print(export(options.source, options.out, options.force, vectors=options.vectors, weights=options.weights))


def _copied(model: Path, options: argparse.Namespace) -> Path:
    """Copy an exported model, with test vectors or in a lower precision."""
    if options.weights:
        raise NteError(f"{options.source}: is exported already, and --weights are a run's: give the run")
    if not options.precision:
        from nte.runtime.vectors import copy_with_vectors

        return copy_with_vectors(model, options.out, options.vectors, options.force)
    if options.vectors:
        raise NteError("--precision makes a model, and --vectors are of one: export the copy once more, with --vectors")
    from nte.runtime.precision import lower

    return lower(model, options.out, options.precision, options.calibrate, options.force)
