"""Test vectors: inputs and outputs of an exported model in plain files, by which a port to another program is checked.

A port is checked frame by frame with the state that is given, or over the whole sequence with the state that it keeps
itself: both must give the outputs.
"""

import json
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt
import onnxruntime

from nte.errors import NteError
from nte.files import make_folder, only_writer, remove, write_whole
from nte.frames.scalars import sequence_scalars
from nte.runtime.description import METADATA_KEY, read_description, recurrent_of
from nte.runtime.trial import trial_frames

Values: TypeAlias = npt.NDArray[np.float32]
Listed: TypeAlias = dict[str, dict[str, Any]]  # input or output → its file and shape

INDEX = "vectors.json"
FRAMES, SIZE = 4, (40, 48)
TOLERANCE = 1e-3  # limit of |a − b| / (|b| + 0.01): a hundred times the rounding of another order of summation


def write_vectors(model: Path, folder: Path) -> None:
    """Run a model over four frames of 48×40 pixels, and write its inputs and outputs to a folder.

    The folder gets vectors.json, and a file of little-endian float32 for each input and output. Only ONNX Runtime
    computes, on one thread of the CPU. Raises NteError for a folder that cannot be written to, and for a model that is
    not one of nte.
    """
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1  # so that the same model gives the same bytes on the same machine
    options.log_severity_level = 3
    session = onnxruntime.InferenceSession(str(model), options, providers=["CPUExecutionProvider"])
    inputs = {i.name: i.shape for i in session.get_inputs()}
    outputs = [o.name for o in session.get_outputs()]
    info = read_description(model, session.get_modelmeta().custom_metadata_map.get(METADATA_KEY), inputs, outputs)
    recurrent = recurrent_of(info, inputs)
    state = {name: np.zeros(tensor.shape(1, *SIZE), np.float32) for name, tensor in recurrent.items()}
    depth_scale: Values | None = None
    frames: list[dict[str, Listed]] = []
    with only_writer(folder):
        remove(folder / INDEX)  # until the end, the folder says that it is not finished
        for frame in trial_frames((*info["needs"], *info["optional"]), SIZE, FRAMES, batch=1):
            exposure, measured = sequence_scalars(frame)
            depth_scale = measured if depth_scale is None else depth_scale
            reset = np.full(1, frame.index == 0, np.float32)
            offered = {**frame.channels, "reset": reset, "exposure": exposure, "depth_scale": depth_scale, **state}
            fed = {name: offered[name] for name in inputs}
            made = dict(zip(outputs, session.run(outputs, fed), strict=True))
            state = {name: (fed | made)[tensor.source] for name, tensor in recurrent.items()}
            if bad := [name for name, values in made.items() if not np.isfinite(values).all()]:
                raise NteError(f"{model}: its output '{bad[0]}' is NaN or infinite in frame {frame.index} of a test")
            parts = {"inputs": fed, "outputs": made}
            frames.append({part: _written(folder, frame.index, values) for part, values in parts.items()})
        index = {"model": model.name, "tolerance": TOLERANCE, "frames": frames}
        write_whole(folder / INDEX, lambda path: path.write_text(json.dumps(index, indent=1) + "\n", "utf-8"))


def _written(folder: Path, index: int, values: dict[str, Values]) -> Listed:
    """Write each array to a file of its own in a folder of the frame, and return the table of them."""
    make_folder(folder / str(index))
    listed: Listed = {}
    for name, array in values.items():
        file = f"{index}/{name}.f32"
        write_whole(folder / file, np.ascontiguousarray(array, "<f4").tofile)
        listed[name] = {"file": file, "shape": list(array.shape)}
    return listed
