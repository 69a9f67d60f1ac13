"""Gain from merging a burst, on synthetic photographs of known shifts and noise.

    python -m benchmarks.burst [--size 960x640] [--frames 6] [--pictures FOLDER]

docs/merge_burst.md says how each number is computed.
"""

import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from benchmarks.command import count, make_parser, run
from nte.burst.merge import merge_burst
from nte.burst.noise import NoiseModel, fit_noise
from nte.burst.pictures import write_picture
from nte.cli.parsing import parse_size
from nte.text_table import aligned
from tests.burst.scenes import mosaic_of, psnr, scene, sense

LEVELS = {"weak": NoiseModel(0.0002, 1e-5), "middle": NoiseModel(0.002, 1e-4), "strong": NoiseModel(0.01, 1e-3)}
KINDS = ("bayer", "xtrans", "rgb")
MARGIN = 40  # px at the border that do not count, because other frames may not show them
Shifts = list[tuple[float, float]]


def hand(frames: int, whole: int = 0) -> Shifts:
    """Make shifts in pixels as of a hand that wanders; the first is 0. whole: round to multiples of it, unless 0."""
    steps = np.random.default_rng(3).normal(0, 6, (frames, 2)).cumsum(0).clip(-MARGIN, MARGIN)
    steps -= steps[0]
    return [tuple(map(float, np.round(step / whole) * whole if whole else step)) for step in steps]  # type: ignore[misc]


def measure(
    kind: str, noise: NoiseModel, shifts: Shifts, disc: bool, size: tuple[int, int]
) -> tuple[list[str], list[Tensor]]:
    """Return the cells of a row, and truth, first frame, merged image and the mean without alignment."""
    mosaic = None if kind == "rgb" else mosaic_of(kind)
    middle = size[1] / 2, size[0] / 2
    clean = [scene(size, s, (middle[0] + 9 * i, middle[1]) if disc else None, 24.0) for i, s in enumerate(shifts)]
    frames = [sense(image, mosaic, noise, seed) for seed, image in enumerate(clean)]
    truth = sense(clean[0], mosaic, None, 0)
    fitted = fit_noise(frames[0], frames[1], mosaic)
    start = time.perf_counter()
    merged = merge_burst(frames[0], frames[1:], fitted, mosaic)
    seconds = time.perf_counter() - start
    single, gain = psnr(frames[0], truth, MARGIN), psnr(merged.image, truth, MARGIN)
    mean = psnr(torch.stack(frames).mean(0), truth, MARGIN)
    found = max(np.hypot(*np.subtract(f.motion, s)) for f, s in zip(merged.frames, shifts[1:], strict=True))
    signal = truth.flatten()[::11].quantile(torch.linspace(0.05, 0.95, 7))
    wrong = float((fitted.variance(signal) / noise.variance(signal) - 1).abs().max())
    y, x = (int(value) for value in reversed(middle))
    around = (..., slice(y - 30, y + 30), slice(x - 30, x + 85))
    ghost = (merged.image - truth)[around].square().mean() / (frames[0] - truth)[around].square().mean()
    used = float(np.mean([frame.share for frame in merged.frames]))
    return [
        f"{single:.1f}", f"{mean - single:+.1f}", f"{gain - single:+.1f}", f"{found:.2f}", f"{used:.0%}",
        f"{wrong:.0%}", f"{float(ghost):.2f}" if disc else "", f"{seconds / len(merged.frames):.2f}",
    ], [truth, frames[0], merged.image, torch.stack(frames).mean(0)]  # fmt: skip


def main(arguments: Sequence[str]) -> int:
    """Print the table. With --pictures, write crops of the images of the rows with a disc."""
    parser = make_parser(__doc__)
    parser.add_argument("--size", type=parse_size, default=(640, 960), metavar="WIDTHxHEIGHT")
    parser.add_argument("--frames", type=count, default=6)
    parser.add_argument("--pictures", type=Path)
    given = parser.parse_args(arguments)
    height, width = given.size
    hands: dict[str, Callable[[], Shifts]] = {
        "still": lambda: [(0.0, 0.0)] * given.frames,
        "whole periods": lambda: hand(given.frames, 6),
        "any shift": lambda: hand(given.frames),
    }
    cases = [(kind, "middle", moved, False) for kind in KINDS for moved in hands]
    cases += [(kind, level, "any shift", level == "middle") for kind in KINDS for level in LEVELS]
    titles = ["burst", "one, dB", "mean", "merged", "shift error, px", "used", "noise error", "disc", "s/frame"]
    rows = []
    for kind, level, moved, disc in cases:
        cells, images = measure(kind, LEVELS[level], hands[moved](), disc, (height, width))
        rows.append([f"{kind}, {level} noise, {moved}" + (", disc" if disc else ""), *cells])
        if given.pictures and disc:
            rows_shown, columns_shown = (slice(side // 2 - 80, side // 2 + 80) for side in (height, width))
            strip = torch.cat([image[..., rows_shown, columns_shown] for image in images], 3)
            write_picture(given.pictures / f"{kind}.png", strip[0].expand(3, -1, -1).numpy())
    most = 10 * np.log10(given.frames)
    print(f"{given.frames} frames of {width}x{height}: at most {most:.1f} dB where pixels are not mixed")
    print(aligned([list(column) for column in zip(titles, *rows, strict=True)]))
    return 0


if __name__ == "__main__":
    run(main)
