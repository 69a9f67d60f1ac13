"""A copy of an exported model whose network computes in float16, or in bytes.

Only convolutions change, and what lies between them. Reading, vectors, warping, kernels and blending stay in float32,
and so does the state, in which errors would add up from frame to frame.
"""

import json
import logging
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Literal, TypeAlias

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper
from onnxruntime.quantization import CalibrationDataReader, QuantFormat, quantize_static

from nte.denoiser import Result
from nte.errors import NteError
from nte.files import make_folder, write_whole
from nte.filters.prior import complete
from nte.frames.channels import CHANNELS, TARGETS
from nte.frames.clip import Clip, Pixels
from nte.frames.frame import Frame
from nte.frames.usable import usable
from nte.progress import Progress
from nte.recurrence import NetworkState
from nte.runtime.description import METADATA_KEY, UNSEALED, seal
from nte.runtime.session import OnnxDenoiser
from nte.runtime.trial import difference
from nte.writers import only_writer_of

Precision: TypeAlias = Literal["f16", "int8"]
SIZE = 64, 96  # of the frames by which both are compared
CONVOLUTION = "Conv"
_BETWEEN = {"Relu": 1, "MaxPool": 1, "Resize": 1, "Concat": None}  # operator → how many of its inputs are values


def lower(
    model: Path | str, out: Path | str, precision: Precision, clips: Sequence[Path | str] = (), force: bool = False,
    progress: Callable[[str], None] = print,
) -> Path:  # fmt: skip
    """Write a copy of an exported model whose network has a lower precision, and return its path.

    clips: for int8, typical ones, from all frames of which the range of each value within the network is taken; costs
    three runs of the model a frame. force: replace `out`. progress: called with a line of text on the difference from
    the model, which is told and not judged. Raises NteError for a file that is no exported model or has a lower
    precision already, for int8 without clips, for a clip without light, for a frame that the model cannot denoise, and
    if the copy gives NaN or infinite light where the model does not.
    """
    model, out = Path(model), Path(out)
    full = OnnxDenoiser(model)
    if found := full.info.get("precision"):
        raise NteError(f"{model}: its network is {found} already, expected a model as nte export writes it")
    if (precision == "int8") != bool(clips):
        raise NteError(f"precision {precision} with {len(clips)} clips to calibrate it: int8 needs some, f16 none")
    graph, sequences = onnx.load(model), [Clip(clip) for clip in clips]
    convolutions = [node.name for node in graph.graph.node if node.op_type == CONVOLUTION]
    if not convolutions:
        raise NteError(f"{model}: it has no convolutions, and nothing else has a lower precision")

    def write(temporary: Path) -> None:
        if precision == "f16":
            lowered = halved(graph)
        else:
            _quantize(graph, convolutions, temporary, _fed(model, sequences))
            lowered = onnx.load(temporary)
        description = {**full.info, "sha256": UNSEALED, "precision": precision}
        helper.set_model_props(lowered, {METADATA_KEY: json.dumps(description)})
        onnx.checker.check_model(lowered)
        onnx.save(lowered, temporary)
        seal(temporary)
        typical, worst = difference(OnnxDenoiser(temporary), full, SIZE)
        if not np.isfinite(worst):
            raise NteError(
                f"{out}: not written: in {precision} the image is NaN or infinite where {model.name} has none such"
            )
        progress(f"{precision} differs from {model.name} by {typical:.1e} (99.9th percentile), {worst:.1e} at most")

    with only_writer_of(out, force):
        make_folder(out.parent)
        write_whole(out, write)
    return out


def halved(model: onnx.ModelProto) -> onnx.ModelProto:
    """Let the convolutions of a graph, and what lies between them alone, compute in float16, between casts."""
    graph, nodes = model.graph, list[onnx.NodeProto]()
    weights = {tensor.name: tensor for tensor in graph.initializer}
    half: dict[str, str] = {}  # value → its name in float16
    made: set[str] = set()  # those that are computed in float16
    for node in graph.node:
        values = node.input[: _BETWEEN.get(node.op_type)]
        if node.op_type == CONVOLUTION or (node.op_type in _BETWEEN and made.issuperset(values)):
            for at, name in enumerate(values):
                if name not in half:
                    half[name] = f"{name}/f16"
                    if name in weights:
                        with np.errstate(over="ignore"):  # the trial of the graph finds what becomes infinite
                            rounded = numpy_helper.to_array(weights[name]).astype(np.float16)
                        graph.initializer.append(numpy_helper.from_array(rounded, half[name]))
                    else:
                        nodes.append(_cast(name, half[name], TensorProto.FLOAT16))
                node.input[at] = half[name]
            result = node.output[0]  # a MaxPool may have a second one: indices, which stay as they are
            node.output[0] = half[result] = f"{result}/f16"
            made.add(result)
            nodes += [node, _cast(half[result], result, TensorProto.FLOAT)]
        else:
            nodes.append(node)
    read = {*_read(nodes), *(value.name for value in graph.output)}
    del graph.node[:], graph.value_info[:]
    graph.node.extend(node for node in nodes if node.op_type != "Cast" or node.output[0] in read)
    kept = [tensor for tensor in graph.initializer if tensor.name in read]
    del graph.initializer[:]
    graph.initializer.extend(kept)
    return model


def _read(nodes: Iterable[onnx.NodeProto]) -> Iterator[str]:
    """The names of what nodes read, in their branches as well, which see the values around them."""
    for node in nodes:
        yield from node.input
        for branch in (attribute.g for attribute in node.attribute):  # an empty graph where there is none
            yield from (value.name for value in branch.output)
            yield from _read(branch.node)


def _cast(source: str, target: str, kind: int) -> onnx.NodeProto:
    return helper.make_node("Cast", [source], [target], f"{target}/Cast", to=kind)


def _quantize(
    model: onnx.ModelProto, convolutions: Sequence[str], out: Path, fed: Iterator[Mapping[str, Pixels]]
) -> None:
    """Let convolutions compute with bytes: weights by output channel, what they read between its extremes."""
    with _silent():  # not a path of the model: a file would be written beside it, and removed, or one of that name
        quantize_static(
            model, out, _Reader(fed), QuantFormat.QDQ, op_types_to_quantize=[CONVOLUTION],
            nodes_to_quantize=[*convolutions], per_channel=True,
        )  # fmt: skip


def _fed(model: Path, clips: Sequence[Clip]) -> Iterator[Mapping[str, Pixels]]:
    """Denoise clips with a model, and yield the inputs of its graph at each frame; show progress on stderr."""
    recorder = _Recorder(model)
    denoiser = complete(recorder)
    lights = [name for name in recorder.needs if name in TARGETS]
    with Progress("calibration", sum(map(len, clips)), "frame") as shown:
        for clip in clips:
            state, lit = None, False
            for frame in clip:
                try:
                    _, state = denoiser.step(frame, state)
                except NteError as error:  # it names the frame; there are several clips
                    raise NteError(f"{clip.folder}: {error}") from error
                lit = lit or any(usable(CHANNELS[name], frame[name]).any() for name in lights)
                yield recorder.last
                shown.advance(1)
            if not lit:
                raise NteError(
                    f"{clip.folder}: {' and '.join(lights)} black or NaN in all {len(clip)} frames, so they do not "
                    "tell how large values become: calibrate with clips that have light, such as some of the training"
                )
            shown.say(clip.folder.name)


class _Recorder(OnnxDenoiser):
    """An exported model that keeps what its graph was fed with last."""

    def step(
        self, frame: Frame, state: NetworkState | None, extras: tuple[str, ...] = ()
    ) -> tuple[Result, NetworkState]:
        fed, _ = self.fed(frame, state)
        self.last = {name: np.asarray(fed[name]) for name in self._inputs}
        return super().step(frame, state, extras)


class _Reader(CalibrationDataReader):  # type: ignore[misc]  # ONNX Runtime has no types
    """The inputs of frames, one after the other, as ONNX Runtime asks for them."""

    def __init__(self, fed: Iterator[Mapping[str, Pixels]]) -> None:
        self._fed = fed

    def get_next(self) -> Mapping[str, Pixels] | None:
        return next(self._fed, None)


@contextmanager
def _silent() -> Iterator[None]:
    """Hide ONNX Runtime's advice to fold constants first, which it does itself on loading."""
    logger = logging.getLogger()
    level = logger.level
    logger.setLevel(logging.ERROR)
    try:
        yield
    finally:
        logger.setLevel(level)
