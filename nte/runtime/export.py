"""A trained network → one ONNX graph with the conventions inside, checked before it is written."""

import json
import tempfile
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import onnx
import torch

from nte.errors import NteError
from nte.files import make_folder, only_writer_of, write_whole
from nte.frames.frame import Frame
from nte.models.temporal import TemporalDenoiser
from nte.runtime.description import FORMAT, METADATA_KEY, STATE, UNSEALED, seal
from nte.runtime.session import OnnxDenoiser
from nte.version import __version__

IMAGES = {
    "color": 3, "albedo": 3, "normal": 3, "depth": 1, "motion": 2, "previous_forward_motion": 2,
}  # fmt: skip
SCALARS = ("reset", "exposure", "depth_scale")
OUTPUTS = ("image", "next_history", "disoccluded", "valid", "alpha")
OPSET = 18
SMALLEST = 16

CHECK_SIZES = ((64, 96), (45, 77), (16, 16))
CHECK_FRAMES = 20
TYPICAL, WORST = 1e-4, 0.05  # of |a − b| / (|b| + 0.01): the 99.9th percentile, and the maximum


def export(run: Path | str, out: Path | str, force: bool = False, progress: Callable[[str], None] = print) -> Path:
    """Export a trained run as one ONNX file, checked against PyTorch, and return its path.

    run: a run folder, which stands for its last checkpoint, or a .safetensors file in one. out: the file to write.
    progress: called with a line for each size at which both agree. Raises NteError where the results differ, and where
    `out` exists, unless `force`.

    >>> model = nte.export("runs/mine", "mine.onnx", progress=lambda line: None)
    >>> nte.load_denoiser("mine.onnx").target
    'color'
    """
    from nte.training.run import load_run

    out = Path(out)
    with only_writer_of(out, force):
        export_onnx(load_run(Path(run)), out, progress)
    return out


def export_onnx(denoiser: TemporalDenoiser, path: Path, progress: Callable[[str], None] = print) -> None:
    """Export to `path` after checking ONNX Runtime against PyTorch over recurrent frames at several sizes.

    The graph takes what export/README.md lists; height, width and batch are free (sizes from 16).
    Raises NteError if the results differ, and then writes nothing.
    """
    denoiser = denoiser.cpu().eval()
    model = _graph(denoiser)

    def write(temporary: Path) -> None:
        onnx.save(model, temporary)
        seal(temporary)
        for size in CHECK_SIZES:
            typical, worst = compare_with_torch(denoiser, OnnxDenoiser(temporary), size)
            found = f"{size[1]}x{size[0]}, {CHECK_FRAMES} frames: 99.9th percentile {typical:.1e}, maximum {worst:.1e}"
            if not (typical < TYPICAL and worst < WORST):
                limits = f"expected at most {TYPICAL} and {WORST}"
                raise NteError(f"{path}: not written: ONNX Runtime differs from PyTorch at {found}; {limits}")
            progress(f"ONNX Runtime agrees with PyTorch at {found}")

    make_folder(path.parent)
    write_whole(path, write)


def compare_with_torch(
    denoiser: TemporalDenoiser, exported: OnnxDenoiser, size: tuple[int, int]
) -> tuple[float, float]:
    """(99.9th percentile, maximum) of |a − b| / (|b| + 0.01), b PyTorch's output, over a recurrent sequence."""
    ours, theirs = None, None
    errors = []
    with torch.no_grad():
        for frame in _test_sequence(size, CHECK_FRAMES):
            expected, ours = denoiser.step(frame, ours)
            found, theirs = exported.step(frame, theirs)
            errors.append(np.abs(found.image - expected.image) / (np.abs(expected.image) + 0.01))
    every = np.concatenate([e.ravel() for e in errors])
    return float(np.quantile(every, 0.999)), float(every.max())


def _test_sequence(size: tuple[int, int], frames: int, seed: int = 0) -> Iterator[Frame]:
    """Frames with everything that a graph must cope with: motion across borders, disocclusions, sky, bad pixels."""
    rng = np.random.default_rng(seed)
    shape = (2, *size)
    depth = np.where(rng.random((2, 1, *size)) < 0.05, 0, 4).astype(np.float32)
    for index in range(frames):
        color = rng.exponential(1.0, (2, 3, *size)).astype(np.float32) * rng.random((2, 1, 1, 1), np.float32) * 10
        color[rng.random(color.shape) < 1e-3] = rng.choice([np.nan, np.inf, -1.0])
        motion = rng.normal(0, 2, (2, 2, 1, 1)) + rng.normal(0, 0.2, (2, 2, *size))
        motion[rng.random(shape)[:, None].repeat(2, 1) < 1e-3] = rng.choice([np.nan, 1e20])
        forward = -motion + np.where(rng.random((2, 1, *size)) < 0.1, 6.0, 0.0)
        forward[rng.random(shape)[:, None].repeat(2, 1) < 0.02] = np.nan
        channels = {
            "color": color, "albedo": rng.random((2, 3, *size)), "normal": rng.uniform(-0.6, 0.6, (2, 3, *size)),
            "depth": depth, "motion": motion, "previous_forward_motion": forward,
        }  # fmt: skip
        yield Frame({name: values.astype(np.float32) for name, values in channels.items()}, index)


def _graph(denoiser: TemporalDenoiser) -> onnx.ModelProto:
    """Trace the denoiser with free batch, height and width.

    By the tracing exporter: measured on two cores it takes 2 s, where torch.export needs 150 s to reason about
    the sizes of 75 shifted images. What tracing could silently freeze, the check at several sizes would find.
    """
    order = [*IMAGES, *SCALARS, *STATE]
    channels = IMAGES | STATE
    example = tuple(torch.rand(2, channels[n], 64, 96) if n in channels else torch.ones(2) for n in order)
    axes = {name: {0: "batch", 2: "height", 3: "width"} for name in (*channels, *OUTPUTS)}
    axes |= {name: {0: "batch"} for name in SCALARS}
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings(), torch.no_grad():
        warnings.simplefilter("ignore")  # of the tracer, about what the check looks at
        torch.onnx.export(
            denoiser, example, f"{folder}/graph.onnx", dynamo=False, input_names=order, output_names=list(OUTPUTS),
            dynamic_axes=axes, opset_version=OPSET,
        )  # fmt: skip
        model = onnx.load(f"{folder}/graph.onnx")
    onnx.helper.set_model_props(model, {METADATA_KEY: json.dumps(_description(denoiser))})
    onnx.checker.check_model(model)
    return model


def _description(denoiser: TemporalDenoiser) -> dict[str, object]:
    """What a runtime must know, as JSON in the model's metadata (export/README.md explains it)."""
    return {
        "format": FORMAT,
        "version": __version__,
        "sha256": UNSEALED,  # of the whole file, with zeros here
        "needs": list(denoiser.needs),
        "optional": list(denoiser.optional),
        "target": denoiser.target,
        "state": {"history": "next_history", "previous_depth": "depth"},  # input ← output or input of the frame before
        "smallest": SMALLEST,
        "conventions": {
            "layout": "float32 (N, C, H, W); x to the right, y down, pixel centres at +0.5",
            "color": "linear radiance, scene-referred; bad pixels are sanitised, exposed light capped at 65504",
            "albedo": "[0, 1]",
            "normal": "unit, world space",
            "depth": "along the view axis, scene units; 0 = miss",
            "motion": "pixels, current to previous: previous = current + motion",
            "previous_forward_motion": "pixels, previous frame to the current one; NaN = unknown, 0 = stands still",
            "reset": "(N,), 1 starts a sequence: history is ignored",
            "exposure": "(N,), 0.18 / exp(mean log luminance of the first frame), constant over a sequence",
            "depth_scale": "(N,), median hit depth of the first frame, constant over a sequence",
            "image": "the denoised target in the units of color",
        },
    }
