"""What a released model loses with the channels that frames lack: python -m benchmarks.lacking CLIP…

Prints the mean PSNR in dB of frames 3 on, after the display transform, over the clips, beside Open Image Denoise with
the same channels, and its gain in the clip where it is least, and where it is most.
"""

import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.command import make_parser, run
from benchmarks.conditions import FIRST, denoised, exposure_of, quality
from nte.frames.clip import Clip
from nte.frames.clip_files import find_clips
from nte.frames.frame import Frame
from nte.registry import load_denoiser
from nte.released import DEFAULT
from nte.session import MissingChannelWarning, Session
from nte.text_table import aligned

WANTED = ("albedo", "normal", "depth", "motion")
LACKING = ((), ("depth",), ("normal",), ("albedo",), ("motion",), ("albedo", "normal", "depth"), WANTED)


def psnr_of(spec: str, clip: Clip, lacking: Sequence[str]) -> float:
    """PSNR, dB: the mean over the frames of a clip from FIRST on."""
    names = ["color", "reference", *(name for name in WANTED if name not in lacking)]

    def without(frame: Frame) -> Frame:
        return replace(frame, channels={name: frame[name] for name in names})

    frames = denoised(Session(load_denoiser(spec)), clip, without)
    return float(quality(frames, exposure_of(clip))[FIRST:].mean())


def main(arguments: Sequence[str]) -> None:
    """Print a row for each set of channels that are missing."""
    parser = make_parser(__doc__)
    parser.add_argument("folders", nargs="+", type=Path, metavar="CLIP_OR_FOLDER")
    clips = [Clip(folder) for folder in find_clips(parser.parse_args(arguments).folders)]
    warnings.simplefilter("ignore", MissingChannelWarning)
    rows = [["without", DEFAULT, "oidn", "least gain", "most gain"]]
    for lacking in LACKING:
        ours, theirs = (np.array([psnr_of(spec, clip, lacking) for clip in clips]) for spec in (DEFAULT, "oidn"))
        gain = ours - theirs
        means = f"{ours.mean():.2f}", f"{theirs.mean():.2f}", f"{gain.min():+.2f}", f"{gain.max():+.2f}"
        rows.append([", ".join(lacking) or "nothing", *means])
    print(aligned([list(column) for column in zip(*rows, strict=True)]))


if __name__ == "__main__":
    run(main)
