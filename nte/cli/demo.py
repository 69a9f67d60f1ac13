"""The subcommand `nte demo`."""

import argparse
import time
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING

from nte.cli.parsing import Commands, add_force, command
from nte.released import CLIP, DEFAULT

if TYPE_CHECKING:
    from nte.denoiser import Denoiser

_COMPARED = {"noisy": "noisy, 1 spp", "oidn": "OIDN high", DEFAULT: DEFAULT}


def add(commands: Commands) -> None:
    """Add `demo` to the subcommands of `nte`."""
    text = "denoise the ten frames that come with nte by its released model, beside Open Image Denoise"
    parser = command(commands, "demo", _demo, text)
    parser.add_argument("--out", type=Path, default=Path("nte_demo"), help="folder for the frames (default: nte_demo)")
    add_force(parser)


def _demo(options: argparse.Namespace) -> None:
    from nte.registry import load_denoiser
    from nte.sequences.denoise import denoise_files
    from nte.sequences.pictures import PictureSettings
    from nte.sequences.video import can_write
    from nte.text_table import aligned

    denoisers = {spec: load_denoiser(spec) for spec in _COMPARED}
    both = options.out / ("before_after.webp" if can_write(".webp") else "before_after.png")
    pictures = PictureSettings(png=True, before_after=both, fps=6, view="standard")
    denoise_files([CLIP], denoisers[DEFAULT], options.out, pictures=pictures, force=options.force, spec=DEFAULT)
    rows = [["", "PSNR, dB", "flicker", "ms a frame"]]
    rows += [[title, *_scores(denoisers[spec])] for spec, title in _COMPARED.items()]
    print(aligned([list(column) for column in zip(*rows, strict=True)]))
    print(f"{both}: before and after. The denoised frames, as OpenEXR and PNG, are beside it.")


def _scores(denoiser: "Denoiser") -> list[str]:
    """PSNR and flicker of the displayed frames of the clip, and the median time of a frame.

    Flicker is how much more or less a pixel changes from frame to frame than the reference's does: the mean of
    |Δimage − Δreference|, in hundredths of white.
    """
    import numpy as np

    from nte.frames.clip import Clip
    from nte.frames.scalars import sequence_scalars
    from nte.frames.show import display
    from nte.session import Session

    session, errors, times = Session(denoiser), [], []
    for frame in Clip(CLIP):
        start = time.perf_counter()
        image = session.denoise(frame)
        times.append(1000 * (time.perf_counter() - start))
        exposure = float(sequence_scalars(frame)[0][0])
        errors.append(display(image[0], exposure) - display(frame["reference"][0], exposure))
    psnr = np.mean([-10 * np.log10(np.mean(error**2)) for error in errors])
    flicker = 100 * np.mean(np.abs(np.diff(errors, axis=0)))
    return [f"{psnr:.2f}", f"{flicker:.2f}", f"{median(times):.0f}"]
