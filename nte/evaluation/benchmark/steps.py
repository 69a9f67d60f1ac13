"""The time in each step of a denoiser: a filter's named scopes, a network's modules, an exported graph's operators."""

import json
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from nte.denoiser import Denoiser, State
from nte.evaluation.benchmark.frames import Source
from nte.evaluation.metric_table import Row
from nte.filters.prior import OnTop

WARM_UP = 4  # frames before the timed ones: caches fill, and history grows beyond what filters call young

if TYPE_CHECKING:
    from nte.runtime.session import OnnxDenoiser


def named_steps(denoiser: Denoiser, source: Source, frames: int = 2) -> dict[str, float]:
    """Measure the milliseconds per frame in each step of a denoiser, in the order in which they first begin.

    The steps of a filter are its scopes of torch.profiler.record_function; those of a network are its direct child
    modules, by their names, in PyTorch and in an exported graph. What another denoiser makes of the frame first is the
    step `prior`. frames: number of measured frames, after four others.
    Only CPU time is profiled.
    """
    from nte.runtime.session import OnnxDenoiser

    if isinstance(denoiser, OnTop):
        return _of_both(denoiser, source, frames)
    if isinstance(denoiser, OnnxDenoiser):
        return _of_graph(denoiser, source, frames)
    from torch.profiler import ProfilerActivity, profile

    state: State | None = None
    for index in range(WARM_UP):
        _, state = denoiser.step(source(index), state)
    spent: dict[str, float] = {}
    with _children_recorded(denoiser):
        for index in range(WARM_UP, WARM_UP + frames):
            frame = source(index)
            with profile(activities=[ProfilerActivity.CPU]) as profiler:
                _, state = denoiser.step(frame, state)
            for event in sorted(profiler.events(), key=lambda event: event.time_range.start):
                if event.is_user_annotation:
                    spent[event.name] = spent.get(event.name, 0.0) + event.time_range.elapsed_us() / 1e3 / frames
    return spent


def _of_both(denoiser: OnTop, source: Source, frames: int) -> dict[str, float]:
    """The time of the denoiser below, and the steps of the one on top, which gets the images of the first."""
    state: State | None = None
    images, ends = [], [time.perf_counter()]
    for index in range(WARM_UP + frames):
        result, state = denoiser.below.step(source(index), state)
        images.append(result.image)
        ends.append(time.perf_counter())
    above = named_steps(denoiser.top, lambda index: source(index).with_channels(prior=images[index]), frames)
    return {"prior": 1e3 * (ends[-1] - ends[WARM_UP]) / frames} | above


@contextmanager
def _children_recorded(denoiser: Denoiser) -> Iterator[None]:
    """Let each direct child of a PyTorch module be a named scope; other denoisers stay as they are."""
    import torch
    from torch.profiler import record_function

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
