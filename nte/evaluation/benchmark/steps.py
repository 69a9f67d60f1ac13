"""The time in each step of a denoiser: a filter's named scopes, a network's modules, an exported graph's operators."""

import json
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import torch
from torch.profiler import record_function

from nte.denoiser import Denoiser, State
from nte.evaluation.benchmark.frames import Source
from nte.evaluation.metric_table import Row
from nte.filters.prior import OnTop
from nte.frames.frame import Frame
from nte.machine import wait_for

WARM_UP = 4  # frames before the timed ones: caches fill, and history grows beyond what filters call young

_CPU = torch.device("cpu")

if TYPE_CHECKING:
    from nte.runtime.session import OnnxDenoiser


def named_steps(denoiser: Denoiser, source: Source, frames: int = 2, device: torch.device = _CPU) -> dict[str, float]:
    """Measure the milliseconds per frame in each step of a denoiser, in the order in which they first begin.

    The steps of a filter are its scopes of torch.profiler.record_function; those of a network are its direct child
    modules, by their names, in PyTorch and in an exported graph. What another denoiser makes of the frame first is the
    step `prior`. frames: number of measured frames, after four others. device: where PyTorch computes; each step begins
    and ends when the device has done all work before. Of an exported graph, ONNX Runtime's own clock on the CPU counts.
    """
    from nte.runtime.session import OnnxDenoiser

    if isinstance(denoiser, OnTop):
        return _of_both(denoiser, source, frames, device)
    if isinstance(denoiser, OnnxDenoiser):
        return _of_graph(denoiser, source, frames)
    state: State | None = None
    for index in range(WARM_UP):
        _, state = denoiser.step(source(index), state)
    given = [source(index) for index in range(WARM_UP, WARM_UP + frames)]
    with _children_recorded(denoiser), _stopwatch(device) as spent:
        for frame in given:
            _, state = denoiser.step(frame, state)
    return {name: seconds * 1e3 / frames for name, seconds in spent.items()}


@contextmanager
def _stopwatch(device: torch.device) -> Iterator[dict[str, float]]:
    """Collect the seconds in each scope of record_function within the context: name → sum.

    In the place of the profiler, whose own time would be in the small steps, and which knows the work of a device only
    by the kernels that it runs.
    """
    spent: dict[str, float] = {}
    begun: dict[int, float] = {}

    def begin(scope: record_function) -> record_function:
        wait_for(device)
        spent.setdefault(scope.name, 0.0)
        begun[id(scope)] = time.perf_counter()
        return scope

    def end(scope: record_function, *error: object) -> None:
        wait_for(device)
        spent[scope.name] += time.perf_counter() - begun.pop(id(scope))

    before = {name: getattr(record_function, name) for name in ("__enter__", "__exit__")}
    try:
        for name, method in zip(before, (begin, end), strict=True):
            setattr(record_function, name, method)
        yield spent
    finally:
        for name, method in before.items():
            setattr(record_function, name, method)


def _of_both(denoiser: OnTop, source: Source, frames: int, device: torch.device) -> dict[str, float]:
    """The time of the denoiser below, and the steps of the one on top, which gets the images of the first."""
    state: State | None = None
    images, ends = [], [time.perf_counter()]
    for index in range(WARM_UP + frames):
        result, state = denoiser.below.step(source(index), state)
        wait_for(device)
        images.append(result.image)
        ends.append(time.perf_counter())

    def with_prior(index: int) -> Frame:
        return source(index).with_channels(prior=images[index])

    above = named_steps(denoiser.top, with_prior, frames, device)
    return {"prior": 1e3 * (ends[-1] - ends[WARM_UP]) / frames} | above


@contextmanager
def _children_recorded(denoiser: Denoiser) -> Iterator[None]:
    """Let each direct child of a PyTorch module be a named scope; other denoisers stay as they are."""
    scopes = ExitStack()  # of the child that runs: children of one module run one after the other

    def record(child: torch.nn.Module, name: str) -> None:
        def begin(module: torch.nn.Module, inputs: object) -> None:
            scopes.enter_context(record_function(name))

        def end(module: torch.nn.Module, inputs: object, output: object) -> None:
            scopes.close()

        for handle in (child.register_forward_pre_hook(begin), child.register_forward_hook(end)):
            hooks.callback(handle.remove)

    with ExitStack() as hooks:
        for name, child in denoiser.named_children() if isinstance(denoiser, torch.nn.Module) else ():
            record(child, name)
        yield


def _of_graph(denoiser: "OnnxDenoiser", source: Source, frames: int) -> dict[str, float]:
    """The times of an exported network, from ONNX Runtime's own profile of a second session."""
    with tempfile.TemporaryDirectory() as folder:
        profiled = denoiser.profiled(Path(folder))
        state: State | None = None
        for index in range(WARM_UP + frames):
            _, state = profiled.step(source(index), state)
        events = json.loads(Path(profiled.end_profiling()).read_text())
    return grouped(events, frames)


def grouped(events: list[Row], runs: int) -> dict[str, float]:
    """Sum the milliseconds per run of a graph's operators by step, over the last runs in a profile of ONNX Runtime.

    An operator is named after the modules that it was traced in, such as /prediction/trunk/Conv. What the runtime or
    the tracer adds between them (/Cast, ReorderOutput) counts for the step before it.
    """
    begun = sorted(event["ts"] for event in events if event["name"] == "model_run")[-runs:]
    spent: dict[str, float] = {}
    step = "before the first step"
    for event in sorted(events, key=lambda event: event.get("ts", 0)):
        if event.get("cat") != "Node" or not event["name"].endswith("_kernel_time") or event["ts"] < begun[0]:
            continue
        if event.get("args", {}).get("op_name") == "If":  # what its branch takes is listed operator by operator
            continue
        scopes = event["name"].split("/")
        step = scopes[1] if scopes[0] == "" and len(scopes) > 2 else step
        spent[step] = spent.get(step, 0.0) + event["dur"] / 1e3 / runs
    return spent
