"""ONNX Runtime as an engine, with any of its providers: what is carried from frame to frame stays in their memory."""

import json
import re
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import onnxruntime
from onnxruntime import OrtValue

from nte.errors import NteError, lacking_memory
from nte.frames.clip import Pixels
from nte.runtime.cache import engine_options
from nte.runtime.description import Shapes
from nte.runtime.engine import Spent, Value
from nte.runtime.providers import PROVIDERS, OnnxOptions, asked_of_onnx_runtime, devices_of

# What ONNX Runtime says of an operator, or of an operator set, that it does not have.
_LACKING = (
    "NOT_IMPLEMENTED", "No Op registered", "not a registered function", "Current official support for domain",
    "Unsupported model IR version",
)  # fmt: skip
_RUN, _KERNEL = "model_run", "_kernel_time"  # names in a profile: of a run, and behind those of operators
# What ONNX Runtime puts before the reason: its code, the file once more, a place in its own sources.
_BEFORE = re.compile(
    r"\[ONNXRuntimeError\] : \d+ : \w+ : |Load model from \S.*? failed:|\S+\.(?:cc|h):\d+ .*?\) (?:const )?"
)


class OnnxRuntime:
    """ONNX Runtime with one provider. Recurrent tensors are OrtValues in the provider's memory.

    A run binds new outputs, for which ONNX Runtime's arena gives out memory that nobody holds any more. So nothing
    grows, an array that was handed out stays as it is, and a state can be used again.
    """

    def __init__(self, path: Path, options: OnnxOptions, profiled: bool = False) -> None:
        known, self._path = PROVIDERS[options.provider], path
        self._place = known.memory, options.index if known.memory != "cpu" else 0
        self._folder = tempfile.TemporaryDirectory() if profiled else None  # of the profile
        self.session = session_for(path, options, profile=Path(self._folder.name) if self._folder else None)
        self.inputs: Shapes = {i.name: i.shape for i in self.session.get_inputs()}
        self.outputs = [o.name for o in self.session.get_outputs()]

    def keep(self, array: Pixels) -> Value:
        """Copy an array to the provider's memory."""
        own = array.copy() if self._place[0] == "cpu" else array  # an OrtValue on the CPU is a view
        return OrtValue.ortvalue_from_numpy(own, *self._place)

    def run(self, feed: Mapping[str, Value], shown: Sequence[str], kept: Sequence[str]) -> dict[str, Value]:
        """Run the graph with bound inputs and outputs."""
        bound = self.session.io_binding()
        for name, value in feed.items():
            if isinstance(value, OrtValue):
                bound.bind_ortvalue_input(name, value)
            else:
                bound.bind_cpu_input(name, value)
        for name in shown:
            bound.bind_output(name)
        for name in kept:
            bound.bind_output(name, *self._place)
        try:
            self.session.run_with_iobinding(bound)
        except Exception as error:  # ONNX Runtime raises classes of its own that share no public base
            raise NteError(f"{self._path}: cannot run this frame: {_reason(error)}") from error
        made = dict(zip([*shown, *kept], bound.get_outputs(), strict=True))
        return {name: value.numpy() if name in shown else value for name, value in made.items()}

    def profile(self) -> list[Spent]:
        """End the profile and return each frame's operators, by ONNX Runtime's own clock."""
        return spent_in(json.loads(Path(self.session.end_profiling()).read_text()))


def session_for(
    path: Path, options: OnnxOptions, profile: Path | None = None, record: bool = False
) -> onnxruntime.InferenceSession:
    """Start a session of ONNX Runtime; a provider that does not start is an error, not a reason for another one.

    record: note which provider takes which operator.
    """
    known, settings = PROVIDERS[options.provider], onnxruntime.SessionOptions()
    settings.intra_op_num_threads = options.threads or 0
    settings.log_severity_level = 4  # none: errors are raised, and the runtime warns about its own graph rewriting
    if profile is not None:
        settings.enable_profiling, settings.profile_file_prefix = True, str(profile / "profile")
    if record:
        settings.add_session_config_entry("session.record_ep_graph_assignment_info", "1")
    # A plan of memory is made from the first frame, and takes one large piece beside what that frame left: at 1280x720
    # the quick start's model has 1465 MB instead of 827, and is 1 to 3 % faster. DirectML allows no plan.
    settings.enable_mem_pattern = options.provider not in ("cpu", "directml")
    asked = asked_of_onnx_runtime(options)
    if options.provider == "tensorrt":
        asked[0][1].update(engine_options(path))
    if known.plugin:  # which ONNX Runtime does not know by name
        settings.add_provider_for_devices(devices_of(options.provider)[:1], dict(known.options))
        asked = []
    try:
        session = onnxruntime.InferenceSession(str(path), settings, providers=asked, enable_fallback=0)
    except Exception as error:  # ONNX Runtime raises classes of its own that share no public base
        what = "not a readable ONNX model" if options.provider == "cpu" else f"{options.provider} cannot run it"
        if any(sign in str(error) for sign in _LACKING):
            what = f"{options.provider} lacks an operator of the model, or its version"
        raise NteError(f"{path}: {what}: {_reason(error)}") from error
    if known.name not in (used := session.get_providers()):
        raise NteError(f"{path}: {options.provider} did not start; ONNX Runtime would use {', '.join(used)} instead")
    return session


def spent_in(events: list[dict[str, Any]]) -> list[Spent]:
    """Return the operators of each run in the events of ONNX Runtime's profile."""
    runs: list[Spent] = []
    for event in sorted(events, key=lambda event: (event.get("ts", 0), event["name"] != _RUN)):
        branches = event.get("args", {}).get("op_name") == "If"  # what its branch takes is listed operator by operator
        if event["name"] == _RUN:
            runs.append([])
        elif event.get("cat") == "Node" and event["name"].endswith(_KERNEL) and not branches:
            runs[-1].append((event["name"].removesuffix(_KERNEL), event["dur"] / 1e3))
    return runs


def _reason(error: Exception) -> str:
    """What an error says: how much memory was missing, or its first line, from where it says what is wrong."""
    if (memory := lacking_memory(error)) is not None:
        return memory
    first = next(iter(str(error).splitlines()), "")
    return _BEFORE.sub("", first).strip() or type(error).__name__
