"""Memory and time of training batches, with decoded clips in memory and in files; the clips need no renderer.

python -m benchmarks.training_data [--size 1280x720] [--clips 2] [--frames 6] [--crop 256] [--batch 4]
"""

import argparse
import os
import tempfile
import threading
import time
from collections.abc import Sequence
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from benchmarks.command import count, make_parser, run
from nte.cli.parsing import parse_size
from nte.frames.clip import Clip, write_frame
from nte.frames.clip_files import frame_path
from nte.frames.clip_info import write_clip_info
from nte.training.config import DataConfig
from nte.training.data import TrainingBatches

CHANNELS = ("color", "albedo", "normal", "depth", "motion", "previous_forward_motion", "reference")
STEPS = 40


def write_clips(folder: Path, size: tuple[int, int], clips: int, frames: int) -> None:
    """Write clips of noisy frames over a smooth picture, which EXR compresses about as little as renderings."""
    rng = np.random.default_rng(0)
    y, x = np.indices(size, np.float32)
    smooth = np.stack([np.sin(x / 31 + c) * np.cos(y / 23 - c) for c in range(3)]).astype(np.float32)
    for clip in range(clips):
        for i in range(frames):
            channels = {
                "color": rng.exponential(size=(3, *size)).astype(np.float32), "albedo": 0.5 + 0.4 * smooth,
                "normal": smooth, "depth": 5 + smooth[:1], "motion": 3 * smooth[:2], "forward_motion": -3 * smooth[:2],
                "reference": 1 + 0.5 * smooth,
            }  # fmt: skip
            write_frame(frame_path(folder / f"clip_{clip}", i), channels)
        write_clip_info(folder / f"clip_{clip}", {"width": size[1], "height": size[0], "frames": frames})


class Memory:
    """Peak of this process's anonymous memory, which the system cannot drop and read again, while the block runs."""

    def __enter__(self) -> "Memory":
        self.most, self._running = self.now(), True
        self._thread = threading.Thread(target=self._watch)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._running = False
        self._thread.join()

    def _watch(self) -> None:
        while self._running:
            self.most = max(self.most, self.now())
            time.sleep(0.01)

    @staticmethod
    def now() -> float:
        """Return the anonymous memory of this process, megabytes."""
        lines = Path("/proc/self/status").read_text().splitlines()
        return next(int(line.split()[1]) for line in lines if line.startswith("RssAnon")) / 1024


def measure(folder: Path, options: argparse.Namespace, where: str) -> None:
    """Measure one way and print one line. where: `memory` or `files`."""
    clips = [Clip(path) for path in sorted(folder.glob("clip_*"))]
    config = DataConfig(
        clips=["."], frames=options.frames - 1, crop=options.crop, batch=options.batch, any_start=True, augment=True,
        cache_gb=1e9 if where == "memory" else 0.0,
    )  # fmt: skip
    before = Memory.now()
    with Memory() as memory:
        steps = TrainingBatches(clips, CHANNELS, config, 1, 0, 1, folder / "decoded")
        start = time.perf_counter()
        for index in range(len(clips)):
            steps.store.get(index, 0)
        decoded = time.perf_counter() - start
        cold = min(timed(steps, step, folder) for step in range(5)) if where == "files" else None
        warm = min(timed(steps, step, None) for step in range(STEPS))
    print(
        f"{where:7} {steps.store.gigabytes():5.2f} GB decoded, {1000 * decoded / len(clips) / options.frames:5.0f} ms "
        f"a frame, once; anonymous memory {memory.most - before:6.0f} MB; a batch {1000 * warm:6.1f} ms"
        + ("" if cold is None else f", {1000 * cold:6.1f} where it comes from the disk")
    )


def timed(steps: TrainingBatches, step: int, dropped: Path | None) -> float:
    """Return the seconds that a batch takes.

    dropped: the folder whose tiles the system is asked to forget before; None to keep them.
    """
    if dropped is not None:
        steps.store._open.clear()
        for path in dropped.rglob("tiles.npy"):
            with path.open("rb") as file:
                os.posix_fadvise(file.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)
    start = time.perf_counter()
    steps[step]
    return time.perf_counter() - start


def main(arguments: Sequence[str]) -> None:
    """Write clips, and measure each way in a process of its own."""
    parser = make_parser(__doc__)
    parser.add_argument("--size", type=parse_size, default=(720, 1280), metavar="WIDTHxHEIGHT")
    for name, value in (("clips", 2), ("frames", 6), ("crop", 256), ("batch", 4)):
        parser.add_argument(f"--{name}", type=count, default=value)
    options = parser.parse_args(arguments)
    if options.crop > min(options.size):
        parser.error(f"--crop {options.crop}: expected at most {min(options.size)}, as --size has")
    with tempfile.TemporaryDirectory(dir=".") as name:
        write_clips(Path(name), options.size, options.clips, options.frames)
        for where in ("memory", "files"):
            process = get_context("spawn").Process(target=measure, args=(Path(name), options, where))
            process.start()
            process.join()


if __name__ == "__main__":
    run(main)
