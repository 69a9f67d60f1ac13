"""How a denoiser does where conditions change: python -m benchmarks.conditions DENOISER CLIP…

Prints means over the clips, beside Open Image Denoise: the PSNR in dB of the first frames of a sequence; of frames 3 on
with light 16 times as dark and as bright; how far a frame without noise (the reference) is changed; the PSNR of the
frames behind a cut to the next clip, less than that of a sequence that starts there; and how much brighter the images
are than the references.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
import torch

from benchmarks.command import make_parser, run
from nte.color import psnr
from nte.frames.clip import Clip, Pixels
from nte.frames.clip_files import find_clips
from nte.frames.frame import Frame
from nte.frames.scalars import sequence_scalars
from nte.frames.show import display
from nte.registry import load_denoiser
from nte.session import Session
from nte.text_table import aligned

AGAINST = "oidn"
FIRST = 3
CUT = 4  # the first frame behind a cut: its vectors are about one that was not shown
BEHIND = 0, 1, 2, 5, 10  # frames behind a cut that are looked at
NOISELESS = 0.999  # quantile of the relative change of pixels

Change = Callable[[Frame], Frame]


def scaled(factor: float) -> Change:
    """Multiply the light of a frame, and of its reference."""
    return lambda frame: frame.with_channels(color=factor * frame["color"], reference=factor * frame["reference"])


def converged(frame: Frame) -> Frame:
    """Give the reference in place of the noisy light."""
    return frame.with_channels(color=frame["reference"])


def denoised(
    session: Session, clip: Clip, change: Change = lambda frame: frame, start: int = 0
) -> Iterator[tuple[Pixels, Pixels]]:
    """Yield image and reference (3, H, W) of each frame of a clip, from `start` on."""
    for index in range(start, len(clip)):
        frame = change(clip.frame(index))
        yield np.asarray(session.denoise(frame)[0]), np.asarray(frame["reference"][0])


def quality(frames: Iterable[tuple[Pixels, Pixels]], exposure: float) -> Pixels:
    """PSNR of each image against its reference, dB, after the display transform."""
    errors = [display(image, exposure) - display(reference, exposure) for image, reference in frames]
    return np.array([float(psnr(torch.tensor(np.square(error).mean()))) for error in errors])


def exposure_of(clip: Clip) -> float:
    return float(sequence_scalars(clip.frame(0))[0][0])


def figures(spec: str, clips: Sequence[Clip]) -> dict[str, float]:
    """What the table has of a denoiser, as means over the clips."""
    found: dict[str, list[float]] = {}

    def note(name: str, value: float) -> None:
        found.setdefault(name, []).append(float(value))

    def begun() -> Session:
        return Session(load_denoiser(spec))

    for clip in clips:
        exposure, plain = exposure_of(clip), list(denoised(begun(), clip))
        of_plain = quality(plain, exposure)
        for index, value in enumerate(of_plain[:5]):
            note(f"frame {index}: PSNR", value)
        image, reference = (np.mean([pair[i] for pair in plain], axis=0) for i in (0, 1))
        note("brighter than the references, %", 100 * (image.mean() / reference.mean() - 1))
        note("light x 1: PSNR", of_plain[FIRST:].mean())
        for name, factor in (("1/16", 1 / 16), ("16", 16.0)):
            lit = denoised(begun(), clip, scaled(factor))
            note(f"light x {name}: PSNR", quality(lit, exposure / factor)[FIRST:].mean())
        kept = list(denoised(begun(), clip, converged))[FIRST:]
        changes = [abs(image - clean) / (clean + 0.01 * clean.mean()) for image, clean in kept]
        most = np.quantile(changes, NOISELESS, axis=(1, 2, 3)).mean()
        note("without noise: 99.9th percentile of the change, %", 100 * most)
    for before, behind in pairwise(clips):
        session, exposure = begun(), exposure_of(behind)
        list(denoised(session, before))
        after = quality(denoised(session, behind, start=CUT), exposure)
        fresh = quality(denoised(begun(), behind, start=CUT), exposure)
        for index in BEHIND:
            if index < len(after):
                note(f"frame {index} behind a cut: PSNR lost", fresh[index] - after[index])
    return {name: float(np.mean(values)) for name, values in found.items()}


def main(arguments: Sequence[str]) -> None:
    """Print a row for each figure."""
    parser = make_parser(__doc__)
    parser.add_argument("denoiser")
    parser.add_argument("folders", nargs="+", type=Path, metavar="CLIP_OR_FOLDER")
    options = parser.parse_args(arguments)
    clips = [Clip(folder) for folder in find_clips(options.folders)]
    ours, theirs = (figures(spec, clips) for spec in (options.denoiser, AGAINST))
    rows = [["", options.denoiser, AGAINST], *([name, f"{ours[name]:.2f}", f"{theirs[name]:.2f}"] for name in ours)]
    print(aligned([list(column) for column in zip(*rows, strict=True)]))


if __name__ == "__main__":
    run(main)
