"""The subcommand `nte export`."""

import argparse
from pathlib import Path

from nte.cli.parsing import Commands, add_force, command


def add(commands: Commands) -> None:
    """Add `export` to the subcommands of `nte`."""
    text = "export a run as one ONNX file, checked against PyTorch"
    parser = command(commands, "export", _export, text, "train")
    parser.add_argument("source", type=Path, metavar="RUN", help="run folder, or a .safetensors file in one")
    parser.add_argument("--out", type=Path, required=True, metavar="MODEL.onnx", help="file to write")
    parser.add_argument(
        "--vectors", type=Path, metavar="FOLDER", help="write inputs and outputs of four frames there, to check ports"
    )
    text = "write the weights alone there, for a training's init_from"
    parser.add_argument("--weights", type=Path, metavar="FILE.safetensors", help=text)
    add_force(parser)


def _export(options: argparse.Namespace) -> None:
    from nte.runtime.export import export

    print(export(options.source, options.out, options.force, vectors=options.vectors, weights=options.weights))
