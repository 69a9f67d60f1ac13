"""Test vectors: inputs and outputs of an exported model in plain files, by which a port to another program is checked.

A port is checked frame by frame with the state that is given, or over the whole sequence with the state that it keeps
itself: both must give the outputs.
"""

import json
import shutil
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from nte.errors import NteError
from nte.files import make_folder, refuse_to_replace, remove, write_whole
from nte.frames.frame import Frame
from nte.recurrence import FORWARD, NetworkState, begin, hand_on
from nte.runtime.description import METADATA_KEY, read_description, recurrent_of, require_seal
from nte.runtime.onnx_engine import session_for
from nte.runtime.onnx_file import metadata_of
from nte.runtime.providers import OnnxOptions
from nte.runtime.trial import trial_frames
from nte.writers import only_writer, only_writer_of

Values: TypeAlias = npt.NDArray[np.float32]
Listed: TypeAlias = dict[str, dict[str, str | list[int]]]  # input or output → its file and shape

INDEX = "vectors.json"
FRAMES, SIZE = 4, (40, 48)
TOLERANCE = 1e-3  # limit of |a − b| / (|b| + 0.01): a hundred times the rounding of another order of summation


def write_vectors(model: Path, folder: Path, frames: Iterable[Frame] | None = None) -> None:
    """Run a model over a sequence of frames, and write its inputs and outputs to a folder.

    The folder gets vectors.json, and a file of little-endian float32 for each input and output. Only ONNX Runtime
    computes, on one thread of the CPU. frames: None takes four random ones of 48×40 pixels, with all that a port must
    cope with. Raises NteError for a folder that cannot be written to, for a model that is not one of nte, and for a
    frame that lacks a channel or differs in size.
    """
    session = session_for(model, OnnxOptions(threads=1))  # the same model gives the same bytes on the same machine
    inputs = {i.name: i.shape for i in session.get_inputs()}
    outputs = [o.name for o in session.get_outputs()]
    info = read_description(model, metadata_of(model, METADATA_KEY), inputs, outputs)
    recurrent = recurrent_of(info, inputs)
    state: NetworkState | None = None
    listed: list[dict[str, Listed]] = []
    with only_writer(folder):
        remove(folder / INDEX)  # until the end, the folder says that it is not finished
        for number, frame in enumerate(frames or trial_frames((*info["needs"], *info["optional"]), SIZE, FRAMES, 1)):
            state, reset = begin(frame, state, recurrent, lambda shape: np.zeros(shape, np.float32), inputs)
            offered = {"reset": reset, **state.scalars.known(), **state.tensors}
            if FORWARD in inputs and FORWARD not in frame:  # the graph makes it where it is NaN everywhere
                offered[FORWARD] = np.full_like(frame["motion"], np.nan)
            fed = {name: offered[name] if name in offered else frame[name] for name in inputs}
            made = dict(zip(outputs, session.run(outputs, fed), strict=True))
            state = hand_on(state, recurrent, fed | made)
            if bad := [name for name, values in made.items() if not np.isfinite(values).all()]:
                raise NteError(f"{model}: its output '{bad[0]}' is NaN or infinite in frame {number} of a test")
            parts = {"inputs": fed, "outputs": made}
            listed.append({part: _written(folder, number, values) for part, values in parts.items()})
        index = {"model": model.name, "tolerance": TOLERANCE, "frames": listed}
        write_whole(folder / INDEX, lambda path: path.write_text(json.dumps(index, indent=1) + "\n", "utf-8"))


def copy_with_vectors(
    model: Path, out: Path, folder: Path | None, force: bool = False, progress: Callable[[str], None] = print
) -> Path:
    """Copy an exported model to the file `out`, with test vectors of it in `folder`, and return its path.

    Needs neither the run nor PyTorch. progress: called with a line about the vectors. Raises NteError for a model that
    is not one of nte, and for a file, or vectors in that folder, that exist without `force`.
    """
    if folder is not None:
        refuse_to_replace([folder / INDEX], force)
    with only_writer_of(out, force):
        require_seal(model)
        write_whole(out, lambda temporary: shutil.copyfile(model, temporary))
        if folder is not None:
            write_vectors(out, folder)
            progress(f"test vectors of {FRAMES} frames are in {folder}")
    return out


def _written(folder: Path, index: int, values: dict[str, Values]) -> Listed:
    """Write each array to a file of its own in a folder of the frame, and return the table of them."""
    make_folder(folder / str(index))
    listed: Listed = {}
    for name, array in values.items():
        file = f"{index}/{name}.f32"
        write_whole(folder / file, np.ascontiguousarray(array, "<f4").tofile)
        listed[name] = {"file": file, "shape": list(array.shape)}
    return listed
