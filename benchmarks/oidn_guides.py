"""OIDN with guides that are clean, noisy or aliased: python -m benchmarks.oidn_guides CLIP…

Prints PSNR after the display transform, the mean over frames and clips. The clips' own guides must be clean (those of
datasets/asvgf.yaml are). `noisy` adds Gaussian noise of σ 0.3 to every component. In `aliased`, each pixel's guides are
those of a random pixel among the 3×3 around it.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import torch

from benchmarks.command import make_parser, run
from nte.color import display, psnr
from nte.frames.clip import Clip
from nte.frames.clip_files import find_clips
from nte.frames.frame import Frame
from nte.frames.scalars import sequence_scalars
from nte.registry import load_denoiser
from nte.text_table import aligned

SPECS = (
    "oidn:clean_aux=true", "oidn:clean_aux=false", "oidn:prefilter=true,clean_aux=false", "oidn:prefilter=true", "oidn",
)  # fmt: skip
GUIDES = ("clean", "noisy", "aliased", "none")


def frames_of(clip: Clip, guides: str) -> Iterator[Frame]:
    """Yield the clip's frames with other guides; only the clip's own are declared clean."""
    for frame in clip:
        rng = np.random.default_rng(frame.index)
        albedo, normal = frame["albedo"], frame["normal"]
        if guides == "noisy":
            albedo, normal = (v + rng.normal(0, 0.3, v.shape).astype(np.float32) for v in (albedo, normal))
            albedo, normal = albedo.clip(0, 1), normal / np.linalg.norm(normal, axis=1, keepdims=True).clip(1e-6)
        if guides == "aliased":
            rows, columns = np.indices(frame.size) + rng.integers(-1, 2, (2, *frame.size))
            at = (..., rows.clip(0, clip.height - 1), columns.clip(0, clip.width - 1))
            albedo, normal = albedo[at], normal[at]
        kept = {"color": frame["color"], "reference": frame["reference"]}
        seen = kept if guides == "none" else {**kept, "albedo": albedo, "normal": normal}
        yield Frame(seen, frame.index, exposure=frame.exposure, clean_guides=guides == "clean")


def mean_psnr(spec: str, clip: Clip, guides: str) -> float:
    """Return the mean PSNR, dB, over the frames of a clip."""
    denoiser, found = load_denoiser(spec), []
    exposure = torch.from_numpy(sequence_scalars(clip.frame(0))[0])
    for frame in frames_of(clip, guides):
        image, _ = denoiser.step(frame, None)
        shown, truth = (display(torch.from_numpy(v), exposure) for v in (image.image, frame["reference"]))
        found.append(float(psnr((shown - truth).square().mean())))
    return float(np.mean(found))


def main(arguments: Sequence[str]) -> None:
    """Print a row for each setting and a column for each kind of guides."""
    parser = make_parser(__doc__)
    parser.add_argument("folders", nargs="+", type=Path, metavar="CLIP_OR_FOLDER")
    folders = parser.parse_args(arguments).folders
    clips = [Clip(folder) for folder in find_clips(folders)]
    columns = [["settings", *SPECS]]
    for guides in GUIDES:
        columns.append(
            [guides, *(f"{np.mean([mean_psnr(spec, clip, guides) for clip in clips]):.2f}" for spec in SPECS)]
        )
    print(aligned(columns))


if __name__ == "__main__":
    run(main)
