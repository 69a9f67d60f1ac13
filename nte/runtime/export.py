"""The export of a trained network as one ONNX graph with its conventions, checked before it is written."""

import json
from collections.abc import Callable
from pathlib import Path

import onnx
import torch

from nte.errors import NteError
from nte.files import make_folder, refuse_to_replace, write_whole
from nte.frames.channels import CHANNELS, Channel, Kind, width_of
from nte.models.cost import cost_of
from nte.models.trainable import TrainableDenoiser
from nte.recurrence import FORWARD, MEASURED, SCALARS
from nte.runtime.description import FORMAT, METADATA_KEY, UNSEALED, seal
from nte.runtime.providers import OnnxOptions
from nte.runtime.session import OnnxDenoiser
from nte.runtime.switch import KNOWN, scatter_inside
from nte.runtime.tracing import traced
from nte.runtime.trial import CHECK_FRAMES, difference
from nte.runtime.vectors import FRAMES, INDEX, write_vectors
from nte.version import __version__
from nte.writers import only_writer_of

SMALLEST = 16

LAYOUT = "float32 (N, C, H, W); x to the right, y down, pixel centres at +0.5"
CONVENTIONS_OF_KINDS: dict[Kind, str] = {  # other kinds are described by their unit in the table of channels
    "radiance": "linear radiance, scene-referred; bad pixels are sanitised, exposed light capped at 65504",
    "reflectance": "[0, 1]",
    "direction": "unit, world space",
    "depth": "along the view axis, scene units; 0 = miss",
}
CONVENTIONS = {
    "motion": "pixels, current to previous: previous = current + motion",
    FORWARD: "pixels, previous frame to the current one; NaN = unknown, 0 = stands still; if all of an image is NaN, "
    "the graph makes it from motion and depth",
}
OF_SEQUENCES = {
    "reset": "(N,), 1 starts a sequence: history is ignored",
    "exposure": "(N,), 0.18 / exp(mean log luminance of the first frame); it may change from frame to frame",
    "depth_scale": "(N,), median hit depth of the first frame",
}

CHECK_SIZES = ((64, 96), (45, 77), (16, 16))
TYPICAL, WORST = 1e-4, 0.05  # limits of |a − b| / (|b| + 0.01): of its 99.9th percentile, and of its maximum


def export(
    run: Path | str, out: Path | str, force: bool = False, progress: Callable[[str], None] = print,
    vectors: Path | str | None = None, weights: Path | str | None = None,
) -> Path:  # fmt: skip
    """Export a trained run as one ONNX file, checked against PyTorch, and return its path.

    run: a run folder, which stands for its last checkpoint, or a .safetensors file in one. out: the file to write.
    progress: called with a line of text for each size at which both agree, and for the vectors. vectors: a folder, to
    which inputs and outputs of four frames are written, by which a port of the model is checked. weights: a
    .safetensors file to which the run's weights are written alone, for `init_from`. Raises NteError if the results
    differ, and if one of the files, or vectors in that folder, exist without `force`.

    >>> model = nte.export("runs/mine", "mine.onnx", progress=lambda line: None)
    >>> nte.load_denoiser("mine.onnx").target
    'color'
    """
    from nte.training.initial import write_weights
    from nte.training.run import load_run

    out, folder = Path(out), None if vectors is None else Path(vectors)
    if folder is not None:
        refuse_to_replace([folder / INDEX], force)
    if weights is not None:
        refuse_to_replace([Path(weights)], force)
    with only_writer_of(out, force):
        export_onnx(load_run(Path(run)), out, progress)
        if weights is not None:
            write_weights(Path(run), Path(weights))
        if folder is not None:
            write_vectors(out, folder)
            progress(f"test vectors of {FRAMES} frames are in {folder}")
    return out


def export_onnx(denoiser: TrainableDenoiser, path: Path, progress: Callable[[str], None] = print) -> None:
    """Export a network to `path` after checking ONNX Runtime against PyTorch over 20 recurrent frames at several sizes.

    The graph takes the network's channels, `reset`, `exposure`, `depth_scale` and its recurrent tensors; batch, height
    and width are free (sizes from 16). progress: called with a line of text for each size. The denoiser is moved to the
    CPU. Raises NteError if the results differ, and then writes nothing.
    """
    denoiser = denoiser.cpu().eval()
    model = _graph(denoiser)

    def write(temporary: Path) -> None:
        onnx.save(model, temporary)
        seal(temporary)
        for size in CHECK_SIZES:
            with torch.no_grad():
                typical, worst = difference(OnnxDenoiser(temporary, OnnxOptions(threads=1)), denoiser, size)
            found = f"{size[1]}x{size[0]}, {CHECK_FRAMES} frames: 99.9th percentile {typical:.1e}, maximum {worst:.1e}"
            if not (typical < TYPICAL and worst < WORST):
                limits = f"expected at most {TYPICAL} and {WORST}"
                raise NteError(f"{path}: not written: ONNX Runtime differs from PyTorch at {found}; {limits}")
            progress(f"ONNX Runtime agrees with PyTorch at {found}")

    make_folder(path.parent)
    write_whole(path, write)


def _graph(denoiser: TrainableDenoiser) -> onnx.ModelProto:
    """Trace the denoiser with free batch, height and width; its optional channels are inputs too.

    If tracing silently froze a size, the check at several sizes would find it.
    """
    shapes = {name: tensor.shape(2, 64, 96) for name, tensor in denoiser.recurrent.items()}
    shapes |= {name: (2, width_of(name), 64, 96) for name in denoiser.inputs if name in CHANNELS}
    example = tuple(torch.rand(shapes[name]) if name in shapes else torch.ones(2) for name in denoiser.inputs)
    inputs = [KNOWN if name == FORWARD else name for name in denoiser.inputs]
    axes = {name: {0: "batch", 2: "height", 3: "width"} for name in (*shapes, KNOWN, *denoiser.outputs)}
    axes |= {name: {0: "batch"} for name in SCALARS}
    for name, tensor in denoiser.recurrent.items():
        if tensor.components == 0:
            axes[name] = {0: "batch"}
        elif tensor.scale > 1:
            smaller = {0: "batch", 2: f"height_{tensor.scale}", 3: f"width_{tensor.scale}"}
            axes |= {name: smaller, tensor.source: smaller}
    model = traced(denoiser, example, inputs, denoiser.outputs, axes)
    if any(i.name == KNOWN for i in model.graph.input):
        scatter_inside(model)
    onnx.helper.set_model_props(model, {METADATA_KEY: json.dumps(_description(denoiser))})
    onnx.checker.check_model(model)
    return model


def _description(denoiser: TrainableDenoiser) -> dict[str, object]:
    """The content of the model's metadata, from which a runtime learns how to call the graph."""
    used = [name for name in dict.fromkeys((*denoiser.needs, *denoiser.optional)) if name in denoiser.inputs]
    measured = {MEASURED[name]: name for name in denoiser.inputs if name in MEASURED and MEASURED[name] not in used}
    conventions = {"layout": LAYOUT} | {name: _convention(CHANNELS[name]) for name in used}
    conventions |= {name: f"not an input: {scalar} is measured from it" for name, scalar in measured.items()}
    image = f"the denoised target in the units of {denoiser.target}"
    scales = {name: tensor.scale for name, tensor in denoiser.recurrent.items() if tensor.scale > 1}
    cost = cost_of(denoiser)
    return {
        "format": FORMAT,
        "version": __version__,
        "sha256": UNSEALED,  # later the checksum of the whole file with zeros here
        "needs": [name for name in used if name != FORWARD],  # a graph has no optional input, but FORWARD can be made
        "optional": [*([FORWARD] if FORWARD in used else []), *measured],
        "target": denoiser.target,
        **({"prior": denoiser.prior} if denoiser.prior else {}),
        # recurrent input ← output or input of the previous frame
        "state": {name: tensor.source for name, tensor in denoiser.recurrent.items()},
        **({"scales": scales} if scales else {}),
        "smallest": SMALLEST,
        "cost": cost.lines(),
        "macs": {name: sum(counts) for name, counts in cost.macs.items()},
        "conventions": conventions | OF_SEQUENCES | {"image": image} | dict(denoiser.conventions),
    }


def _convention(row: Channel) -> str:
    """The meaning of a channel's values, in short."""
    said = CONVENTIONS.get(row.name) or CONVENTIONS_OF_KINDS.get(row.kind) or row.unit
    return said if "NaN" in said or not row.nan_means else f"{said}; NaN = {row.nan_means}"
