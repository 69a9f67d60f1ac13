"""What an exported model makes of vectors and exposures as engines have them: quality on clips, and time.

python -m benchmarks.engine RUN CLIP... [--size 1280x720] [--frames 5]
"""

import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from benchmarks.command import count, make_parser, run
from benchmarks.record import record
from nte.cli.parsing import parse_size
from nte.color import display, psnr
from nte.errors import NteError
from nte.evaluation.benchmark.frames import synthetic_frames
from nte.frames.channels import reference_of
from nte.frames.clip import Clip
from nte.frames.frame import Frame
from nte.frames.scalars import sequence_scalars
from nte.recurrence import FORWARD, NetworkState
from nte.runtime.export import export_onnx
from nte.runtime.providers import OnnxOptions
from nte.runtime.session import OnnxDenoiser
from nte.training.run import load_run

CHANGE = 4.0  # of the exposure, in the middle of a clip
Change = Callable[[NetworkState, Frame], NetworkState]


def as_they_are(clip: Clip) -> Iterator[Frame]:
    """The clip's frames with the exposure of the first."""
    return iter(clip)


def unknown(clip: Clip) -> Iterator[Frame]:
    """Frames whose previous_forward_motion is NaN everywhere: the graph scatters it."""
    return (frame.with_channels(**{FORWARD: np.full_like(frame["motion"], np.nan)}) for frame in clip)


def none_at_all(clip: Clip) -> Iterator[Frame]:
    """Frames with one known vector, which points nowhere: all others are unknown, and the graph does not scatter."""
    for frame in unknown(clip):
        frame[FORWARD][..., 0, 0] = 1e6
        yield frame


def zeros(clip: Clip) -> Iterator[Frame]:
    """Frames that say that everything stands still."""
    return (frame.with_channels(**{FORWARD: np.zeros_like(frame["motion"])}) for frame in clip)


def brighter(clip: Clip) -> Iterator[Frame]:
    """Frames whose exposure becomes larger in the middle of the clip."""
    exposure = clip_exposure(clip)
    for frame in clip:
        yield replace(frame, exposure=exposure * np.float32(CHANGE if frame.index >= len(clip) // 2 else 1))


def keep(state: NetworkState, frame: Frame) -> NetworkState:
    """Leave the state as it is."""
    return state


def forget_exposure(state: NetworkState, frame: Frame) -> NetworkState:
    """Say that the history was kept at the exposure of this frame, whichever it was."""
    return state._replace(tensors=state.tensors | {"previous_exposure": np.asarray(frame.exposure)})


def clip_exposure(clip: Clip) -> np.ndarray:
    """The exposure (1,) by which the clip is shown."""
    return sequence_scalars(clip.frame(0))[0]


def shown(denoiser: OnnxDenoiser, clip: Clip, frames: Iterator[Frame], change: Change) -> tuple[float, float, float]:
    """PSNR in dB over the frames but the first; mean light of the middle frame and of the reference there."""
    exposure, state, found = torch.from_numpy(clip_exposure(clip)), None, []
    middle = light = 0.0
    for frame in frames:
        state = None if state is None else change(state, frame)
        result, state = denoiser.step(frame, state)
        image, clean = torch.from_numpy(result.image), torch.from_numpy(frame[reference_of(denoiser.target)])
        error = (display(image, exposure) - display(clean, exposure)).square().mean()
        found.append(float(psnr(error)))
        if frame.index == len(clip) // 2:
            middle, light = float(image.mean()), float(clean.mean())
    return float(np.mean(found[1:])), middle, light


CASES: dict[str, tuple[Callable[[Clip], Iterator[Frame]], Change]] = {
    "vectors of the clip": (as_they_are, keep),
    "NaN everywhere: scattered in the graph": (unknown, keep),
    "unknown, and not scattered": (none_at_all, keep),
    "zeros": (zeros, keep),
    "exposure times 4 in the middle": (brighter, keep),
    "the same, history not converted": (brighter, forget_exposure),
}


def milliseconds(denoiser: OnnxDenoiser, size: tuple[int, int], frames: int) -> tuple[float, float]:
    """Time of a frame whose vectors are given, and of one for which they are scattered: the least of some, in turn."""
    source = synthetic_frames(size, (*denoiser.needs, *denoiser.optional))
    times: tuple[list[float], list[float]] = ([], [])
    state: NetworkState | None = None
    for index in range(2 * frames + 2):
        frame = source(index)
        if index % 2:
            frame = frame.with_channels(**{FORWARD: np.full_like(frame["motion"], np.nan)})
        start = time.process_time()
        _, state = denoiser.step(frame, state)
        times[index % 2].append(time.process_time() - start)
    given, scattered = (1e3 * min(of[1:]) for of in times)
    return given, scattered


def main(arguments: Sequence[str]) -> None:
    """Print the quality of each case and the times."""
    parser = make_parser(__doc__)
    parser.add_argument("source", type=Path, metavar="RUN")
    parser.add_argument("clips", type=Path, nargs="+", metavar="CLIP")
    parser.add_argument("--size", type=parse_size, default=(720, 1280), metavar="WIDTHxHEIGHT")
    parser.add_argument("--frames", type=count, default=5)
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as folder:
        export_onnx(load_run(options.source), Path(folder) / "model.onnx", progress=lambda line: None)
        denoiser = OnnxDenoiser(Path(folder) / "model.onnx", OnnxOptions(threads=1))
    if FORWARD not in denoiser.optional:
        raise NteError(f"{options.source}: takes no {FORWARD}: expected a network with network.motion=dual")
    clips = [Clip(path) for path in options.clips]
    print(f"{'':40}    PSNR   light of the middle frame, of the reference's")
    for name, (frames, change) in CASES.items():
        rows = [shown(denoiser, clip, frames(clip), change) for clip in clips]
        quality, share = np.mean([row[0] for row in rows]), np.mean([row[1] / row[2] for row in rows])
        record("engine", {name: float(quality)}, "dB")
        print(f"{name:40} {quality:7.2f} {share:7.3f}")
    given, scattered = milliseconds(denoiser, options.size, options.frames)
    of = f"{options.size[1]}x{options.size[0]}, one thread"
    record("engine", {f"vectors given, {of}": given, f"scattered, {of}": scattered}, "ms")
    print(f"{of}: {given:.0f} ms with vectors, {scattered:.0f} ms where they are scattered ({scattered / given:.3f})")


if __name__ == "__main__":
    run(main)
