"""Time of `nte denoise`, from files to files, against its parts: python -m benchmarks.files CLIP DENOISER… [options]

A clip is scaled to the size and stored. Then each denoiser works on these files, with a picture beside each frame, and
on frames in memory; and the files alone are read and written, with their pictures. All take turns, and the best of some
rounds counts, because other work on the machine only adds time.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.command import count, make_parser, run
from benchmarks.record import record
from nte.cli.parsing import parse_size
from nte.denoiser import Denoiser, Noisy
from nte.evaluation.benchmark.frames import clip_frames
from nte.frames.clip import write_frame
from nte.frames.clip_files import frame_path
from nte.frames.frame import Frame
from nte.frames.guides import are_clean
from nte.overlap import sleep_while_waiting
from nte.registry import load_denoiser
from nte.sequences.denoise import denoise_files
from nte.sequences.pictures import PictureSettings
from nte.session import Session

LIMIT = 1.3  # the whole may take so many times the slower of its two parts


def _seconds(work: Callable[[], object]) -> float:
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def _alone(denoiser: Denoiser, frames: Sequence[Frame]) -> None:
    session = Session(denoiser)
    for frame in frames:
        session.denoise(frame)


def _measure(spec: str, frames: Sequence[Frame], folder: Path, rounds: int) -> tuple[float, float, float]:
    """Return the seconds per frame of the files alone, of the denoiser alone, and of both."""
    denoiser, out = load_denoiser(spec), folder / "denoised"
    files = [frame_path(folder, index) for index in range(len(frames))]
    tasks: list[Callable[[], object]] = [
        lambda: denoise_files(files, Noisy(), out, exposure=1.0, pictures=PictureSettings(png=True), force=True),
        lambda: _alone(denoiser, frames),
        lambda: denoise_files(files, denoiser, out, exposure=1.0, pictures=PictureSettings(png=True), force=True),
    ]
    times = [[_seconds(task) / len(frames) for task in tasks] for _ in range(rounds)]
    alone, computing, both = (min(column) for column in zip(*times, strict=True))
    return alone, computing, both


def main(arguments: Sequence[str]) -> int:
    """Print the times of each denoiser; return 1 if one of them takes longer than its slower part allows."""
    parser = make_parser(__doc__)
    parser.add_argument("clip", type=Path)
    parser.add_argument("denoisers", nargs="+", metavar="DENOISER")
    parser.add_argument("--size", type=parse_size, default=(720, 1280), metavar="WIDTHxHEIGHT")
    parser.add_argument("--frames", type=count, default=12)
    parser.add_argument("--rounds", type=count, default=3)
    options = parser.parse_args(arguments)
    sleep_while_waiting()  # as nte denoise does
    known = ("color", "albedo", "normal", "depth", "motion", "forward_motion")
    at = clip_frames(options.clip, options.size, known)
    frames = [at(index) for index in range(options.frames)]
    # Loose files do not say that their guides are clean: nte denoise looks at some of them.
    clean = are_clean(frames)
    frames = [replace(frame, clean_guides=clean) for frame in frames]
    slow = False
    with TemporaryDirectory() as name:
        for index, frame in enumerate(frames):
            write_frame(frame_path(Path(name), index), {key: values[0] for key, values in frame.channels.items()})
        size = f"{options.size[1]}x{options.size[0]}"
        print(f"{size}, {len(frames)} frames, best of {options.rounds} rounds, seconds per frame")
        for spec in options.denoisers:
            files, computing, both = _measure(spec, frames, Path(name), options.rounds)
            ratio = both / max(files, computing)
            slow |= ratio > LIMIT
            record("files", {f"{spec}, {size}, from files to files": ratio}, "× the slower part")
            parts = f"files {files:.3f}, denoiser {computing:.3f}, both {both:.3f} = {ratio:.2f} × the slower"
            print(f"{'ok  ' if ratio <= LIMIT else 'SLOW'} {spec:40} {parts}", flush=True)
    return int(slow)


if __name__ == "__main__":
    run(main)
