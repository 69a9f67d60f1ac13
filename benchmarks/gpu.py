"""Milliseconds per frame and per step of networks and filters on a GPU, or on any other device of PyTorch.

python -m benchmarks.gpu [SOURCE…] [--device cuda] [--size 1280x720 1920x1080] [--frames 20] [--results FOLDER]

SOURCE: run folders, training configurations (.yaml; their random weights take the same time), exported models (.onnx).
Networks run in PyTorch as they are and with each step compiled, in float32 (where PyTorch lets an NVIDIA GPU convolve
in TF32) and with autocast to bfloat16; exported models in ONNX Runtime, which the package onnxruntime-gpu brings to
NVIDIA GPUs. Then follow the filters svgf and trmv, and the patch search, `correspondence`. Frames are on the device
before the clock starts, except those of exported models, whose time includes the copies there and back. The figures are
kept in FOLDER, if one is given; python -m benchmarks.history lists those in benchmarks/results.
"""

import statistics
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import torch

from benchmarks.command import count, make_parser, run
from benchmarks.record import record
from nte.cli.parsing import parse_size
from nte.denoiser import Denoiser, State
from nte.errors import NteError
from nte.evaluation.benchmark.frames import Source, synthetic_frames
from nte.evaluation.benchmark.steps import WARM_UP, named_steps
from nte.filters.estimated import matched_grey
from nte.filters.named import load_filter, require_device
from nte.filters.prior import OnTop, complete
from nte.machine import wait_for
from nte.models.registry import make_network
from nte.motion.correspondence import find_motion
from nte.registry import load_denoiser
from nte.runtime.session import OnnxDenoiser
from nte.training.config import load_train_config
from nte.training.run import load_run

FILTERS = ("svgf", "trmv")
BACKEND = "inductor"  # of torch.compile
_DISTINCT = 4  # frames, which are repeated: all of them would fill a GPU


class Case(NamedTuple):
    """One row of the table: a denoiser, and how it runs."""

    name: str
    load: Callable[[], Denoiser]
    bfloat16: bool = False
    on_device: bool = True  # frames are PyTorch tensors on the device; otherwise NumPy arrays


def cases(sources: Sequence[Path], device: str) -> Iterator[Case]:
    """List the rows of the table, networks first."""
    for path in sources:
        if path.suffix == ".onnx":
            yield Case(f"{path.stem} in ONNX Runtime", partial(load_denoiser, path, device), on_device=False)
            continue
        for compile_steps in (False, True):
            for bfloat16 in (False, True):
                ways = ["compiled"] * compile_steps + ["bfloat16" if bfloat16 else "float32"]
                load = partial(network, path, device, compile_steps)
                yield Case(f"{path.stem}, {', '.join(ways)}", load, bfloat16)
    for name in FILTERS:
        yield Case(name, partial(load_filter, name, device))


def network(path: Path, device: str, compile_steps: bool) -> Denoiser:
    """Load the network of a run, or make that of a training configuration, on the device, on top of its prior."""
    if path.suffix in (".yaml", ".yml"):
        torch.manual_seed(0)
        bare = make_network(load_train_config(path, []).network).eval().requires_grad_(False).to(device)
    else:
        bare = load_run(path, device=device)
    if compile_steps:
        for step in bare.children():
            # Not the step itself: its hooks, by which it is timed, stay outside of what is compiled.
            vars(step)["forward"] = torch.compile(step.forward, dynamic=False, backend=BACKEND)
    return complete(bare, device)


def frames_for(case: Case, denoiser: Denoiser, size: tuple[int, int], device: torch.device) -> Source:
    """Make frames of a size that a denoiser can take again and again."""
    source = synthetic_frames(size, [*denoiser.needs, *denoiser.optional])
    made = [source(index) for index in range(_DISTINCT)]
    made = [frame.torch(device) for frame in made] if case.on_device else made
    return lambda index: made[index % _DISTINCT]


def milliseconds(once: Callable[[int], object], frames: int, device: torch.device) -> float:
    """Return the median time of calls with the numbers of frames, after some to warm up."""
    times = []
    for index in range(WARM_UP + frames):
        wait_for(device)
        begin = time.perf_counter()
        once(index)
        wait_for(device)
        times.append(1e3 * (time.perf_counter() - begin))
    return statistics.median(times[WARM_UP:])


@torch.no_grad()
def measure(case: Case, size: tuple[int, int], frames: int, device: torch.device) -> dict[str, float]:
    """Return the milliseconds of a frame, as `frame`, and those of each step.

    The steps of an exported model are known on the CPU alone.
    """
    denoiser = case.load()
    source = frames_for(case, denoiser, size, device)
    state: State | None = None

    def once(index: int) -> None:
        nonlocal state
        _, state = denoiser.step(source(index), state)

    with torch.autocast(device.type, torch.bfloat16, enabled=case.bfloat16):
        whole = milliseconds(once, frames, device)
        graph = isinstance(denoiser.top if isinstance(denoiser, OnTop) else denoiser, OnnxDenoiser)
        if graph and device.type != "cpu":
            return {"frame": whole}
        return {"frame": whole} | named_steps(denoiser, source, frames, device)


def measure_search(size: tuple[int, int], frames: int, device: torch.device) -> dict[str, float]:
    """Return the milliseconds in which the patch search finds the motion of a frame."""
    source = synthetic_frames(size, ["color"])
    images = [matched_grey(source(i).torch(device)["color"], torch.ones(1, device=device)) for i in range(_DISTINCT)]
    pairs = [(images[i], images[i - 1]) for i in range(_DISTINCT)]
    return {"frame": milliseconds(lambda index: find_motion(*pairs[index % _DISTINCT]), frames, device)}


def device_name(device: torch.device) -> str:
    """Return the name of a device as its maker gives it, or as PyTorch does."""
    named = getattr(getattr(torch, device.type, None), "get_device_name", None)
    return str(named(device)) if named else str(device)


def main(arguments: Sequence[str]) -> None:
    """Print the times of every row at every size, and keep them if a folder is given; say why a row cannot run."""
    parser = make_parser(__doc__)
    parser.add_argument("sources", type=Path, nargs="*", metavar="SOURCE")
    parser.add_argument("--device", default="cuda")
    parser.add_argument("--size", type=parse_size, nargs="+", default=[(720, 1280), (1080, 1920)], metavar="SIZE")
    parser.add_argument("--frames", type=count, default=20)
    parser.add_argument("--results", type=Path, metavar="FOLDER", help="append the figures to the machine's file there")
    options = parser.parse_args(arguments)
    require_sources(options.sources)
    require_device(options.device)
    device = torch.device(options.device)
    where = device_name(device)
    print(
        f"{where}, PyTorch {torch.__version__}: milliseconds, the median of {options.frames} frames; steps: their mean"
    )
    for height, width in options.size:
        how = (height, width), options.frames, device
        rows = [(case.name, partial(measure, case, *how)) for case in cases(options.sources, options.device)]
        rows.append(("correspondence", partial(measure_search, *how)))
        for name, measured in rows:
            try:
                times = measured()
            except (NteError, RuntimeError) as error:  # a type or operator that a device lacks, no compiler, no memory
                print(f"{name}, {width}x{height}: not measured: {str(error).strip().splitlines()[0]}")
                continue
            if options.results:
                of = f"{name}, {width}x{height}, {where}"
                record("gpu", {f"{of}, {step}": taken for step, taken in times.items()}, "ms", options.results)
            whole = times.pop("frame")
            steps = "".join(f"; {step} {taken:.2f}" for step, taken in times.items())
            print(f"{name}, {width}x{height}: {whole:.2f}{steps}", flush=True)


def require_sources(sources: Sequence[Path]) -> None:
    """Raise NteError for a source that is not there or nothing that can be measured."""
    for path in sources:
        if not path.exists():
            raise NteError(f"{path}: does not exist: expected a run folder, a configuration (.yaml) or a model (.onnx)")
        if not (path.suffix in (".onnx", ".yaml", ".yml", ".safetensors") or (path / "config.yaml").is_file()):
            raise NteError(f"{path}: expected a run folder, a configuration (.yaml) or a model (.onnx)")


if __name__ == "__main__":
    run(main)
