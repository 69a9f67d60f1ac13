"""OpenVINO as an engine: it reads the same file as ONNX Runtime, and takes the whole graph.

It is used by itself and not as ONNX Runtime's provider of that name: in onnxruntime-openvino 1.24.1 the provider splits
our graphs into pieces that depend on each other in a circle, which ends the process.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

import openvino

from nte.errors import NteError
from nte.frames.clip import Pixels
from nte.runtime.description import Shapes
from nte.runtime.engine import Spent, Value
from nte.runtime.openvino_cache import DEVICE, compiled
from nte.runtime.providers import OnnxOptions


class OpenVino:
    """A graph that OpenVINO runs on the CPU. What is carried from frame to frame are NumPy arrays.

    Inputs are read where they are. Outputs are copied out of a request, which the next frame takes; each thread that
    computes at the same time has one of its own.
    """

    def __init__(self, path: Path, options: OnnxOptions, profiled: bool = False) -> None:
        settings: dict[str, str | int] = {
            "INFERENCE_PRECISION_HINT": options.precision,
            "PERFORMANCE_HINT": "LATENCY",
            "PERF_COUNT": "YES" if profiled else "NO",
        }
        if options.threads is not None:
            settings["INFERENCE_NUM_THREADS"] = options.threads
        with _told(f"{path}: openvino cannot run it"):
            self._compiled = compiled(path, settings)
        self.path = path
        ports = self._compiled.inputs
        self.inputs: Shapes = {port.any_name: [_size(side) for side in port.partial_shape] for port in ports}
        self.outputs = [_name(port) for port in self._compiled.outputs]
        self._idle: list[openvino.InferRequest] = []
        self._spent: list[Spent] | None = [] if profiled else None

    def keep(self, array: Pixels) -> Value:
        """Copy an array."""
        return array.copy()

    def run(self, feed: Mapping[str, Value], shown: Sequence[str], kept: Sequence[str]) -> dict[str, Value]:
        """Run the graph in a request that no other thread uses."""
        try:
            request = self._idle.pop()
        except IndexError:
            request = self._compiled.create_infer_request()
        with _told(f"{self.path}: openvino cannot run this frame"):
            request.infer(dict(feed), share_inputs=True)
        if self._spent is not None:
            self._spent.append([_spent(node) for node in request.get_profiling_info()])
        made = {name: request.get_tensor(name).data.copy() for name in (*shown, *kept)}
        self._idle.append(request)
        return made

    def profile(self) -> list[Spent]:
        """Return the operators of each frame, by OpenVINO's own clock."""
        return self._spent or []


def refused_by_openvino(path: Path) -> list[str]:
    """Ask OpenVINO which operators of a model it does not take on the CPU."""
    core = openvino.Core()
    with _told(f"{path}: openvino cannot read it"):
        model = core.read_model(path)
        taken = core.query_model(model, DEVICE)
    return sorted({node.get_type_name() for node in model.get_ops() if node.get_friendly_name() not in taken})


def _size(side: openvino.Dimension) -> int | str:
    return int(side.get_length()) if side.is_static else "free"


def _name(port: openvino.ConstOutput) -> str:
    """The name of an output in the file: a graph that was just compiled calls it by that of an operator as well."""
    return str(next(name for name in sorted(port.names) if not name.startswith("/")))


def _spent(node: openvino.ProfilingInfo) -> tuple[str, float]:
    """The name of an operator, and its milliseconds. A reordering of memory is named after two operators."""
    name = node.node_type if node.node_type == "Reorder" else node.node_name
    return str(name), 1e3 * node.real_time.total_seconds()


@contextmanager
def _told(what: str) -> Iterator[None]:
    """Say in one line what OpenVINO finds wrong: operators that it lacks, else the last line, which is the cause."""
    try:
        yield
    except Exception as error:  # RuntimeError, and classes of its own
        lines = [line.strip(" -") for line in str(error).splitlines() if line.strip(" -")]
        lacking = [line for line in lines if line.startswith("No conversion rule")]
        raise NteError(f"{what}: {[type(error).__name__, *lines, *lacking][-1]}") from error
