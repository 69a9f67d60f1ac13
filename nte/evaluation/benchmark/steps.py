"""The time in each step of a denoiser: a filter's named scopes, a network's modules, an exported graph's operators."""

import re
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from functools import partial
from typing import TYPE_CHECKING

import torch

from nte.denoiser import Denoiser, State
from nte.evaluation.benchmark.frames import Source
from nte.filters.prior import OnTop
from nte.filters.scope import scope, timed_scopes
from nte.frames.frame import Frame
from nte.machine import wait_for
from nte.runtime.engine import Spent

WARM_UP = 4  # frames before the timed ones: caches fill, and history grows beyond what filters call young

_CPU = torch.device("cpu")
_FUSED = re.compile(r"/\w+Fusion\w*$")  # what ONNX Runtime puts behind the name of an operator that it fused

if TYPE_CHECKING:
    from nte.runtime.session import OnnxDenoiser


def named_steps(denoiser: Denoiser, source: Source, frames: int = 2, device: torch.device = _CPU) -> dict[str, float]:
    """Measure the milliseconds per frame in each step of a denoiser, in the order in which they first begin.

    The steps of a filter are its scopes (nte.filters.scope); those of a network are its direct child modules, by their
    names, in PyTorch and in an exported graph. What another denoiser makes of the frame first is the step `prior`.
    frames: number of measured frames, after four others. device: where PyTorch computes; each step begins and ends when
    the device has done all work before. Of an exported graph, its engine's own clock on the CPU counts.
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
    with _children_named(denoiser), timed_scopes(partial(wait_for, device)) as spent:
        for frame in given:
            _, state = denoiser.step(frame, state)
    return {name: seconds * 1e3 / frames for name, seconds in spent.items()}


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
def _children_named(denoiser: Denoiser) -> Iterator[None]:
    """Let each direct child of a PyTorch module be a named scope; other denoisers stay as they are."""
    scopes = ExitStack()  # of the child that runs: children of one module run one after the other

    def record(child: torch.nn.Module, name: str) -> None:
        def begin(module: torch.nn.Module, inputs: object) -> None:
            scopes.enter_context(scope(name))

        def end(module: torch.nn.Module, inputs: object, output: object) -> None:
            scopes.close()

        for handle in (child.register_forward_pre_hook(begin), child.register_forward_hook(end)):
            hooks.callback(handle.remove)

    with ExitStack() as hooks:
        for name, child in denoiser.named_children() if isinstance(denoiser, torch.nn.Module) else ():
            record(child, name)
        yield


def _of_graph(denoiser: "OnnxDenoiser", source: Source, frames: int) -> dict[str, float]:
    """The times of an exported network, from its engine's profile of a second one beside it, frame by frame.

    Profiling slows it down; the times are scaled so that their sum is within that of a frame without it.
    """
    pair, seconds = (denoiser, denoiser.profiled()), [0.0, 0.0]
    states: list[State | None] = [None, None]
    for index in range(WARM_UP + frames):
        frame = source(index)
        for i, one in enumerate(pair):
            begin = time.perf_counter()
            _, states[i] = one.step(frame, states[i])
            seconds[i] += time.perf_counter() - begin if index >= WARM_UP else 0.0
    slowed = seconds[1] / seconds[0]
    return {name: spent / slowed for name, spent in grouped(pair[1].profile()[-frames:]).items()}


def grouped(frames: Sequence[Spent]) -> dict[str, float]:
    """Sum the milliseconds per frame of a graph's operators by step.

    An operator is named after the modules that it was traced in, such as /prediction/trunk/Conv. What the engine or
    the tracer adds between them (/Cast, ReorderOutput) counts for the step before it.
    """
    spent: dict[str, float] = {}
    for operators in frames:
        step = "before the first step"
        for name, milliseconds in operators:
            scopes = _FUSED.sub("", name).split("/")
            step = scopes[1] if scopes[0] == "" and len(scopes) > 2 else step
            spent[step] = spent.get(step, 0.0) + milliseconds / len(frames)
    return {name: milliseconds for name, milliseconds in spent.items() if milliseconds}  # inputs are operators of 0 ms
