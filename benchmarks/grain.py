"""Error of glossy light, split into displacement and grain: what a mean over 7×7 pixels keeps, and what it removes.

    python -m benchmarks.grain CLIP …

For clips of datasets/compare_trmv.yaml; docs/comparison_trmv.md explains the split.
"""

from collections.abc import Sequence
from pathlib import Path

import torch
from torch import Tensor

from benchmarks.command import make_parser, run
from nte.evaluation.metrics import regions_of
from nte.evaluation.targets import displayed, read_truth
from nte.frames.clip import Clip
from nte.frames.scalars import sequence_scalars
from nte.motion.box import box_mean
from nte.registry import load_denoiser
from nte.session import Session
from nte.text_table import aligned

PLAIN = "clamp=inf,cleanup=false"
VECTORS = {
    f"traditional, {PLAIN}": f"trmv:target=glossy,glossy=traditional,{PLAIN}",
    f"specular, {PLAIN}": f"trmv:target=glossy,glossy=specular,{PLAIN}",
    f"reliable, {PLAIN}": f"trmv:target=glossy,{PLAIN}",
    "reliable, all defaults": "trmv:target=glossy",
    "none: the spatial filter alone": "trmv:target=glossy,glossy=none",
}
WINDOW = 7  # px


def errors(clip: Clip, spec: str) -> Tensor:
    """Return RMSE, the part that the mean keeps, the part that it removes, and the share without history, (4,).

    All are over the glossy pixels of all frames but the first.
    """
    session = Session(load_denoiser(spec))
    exposure = torch.from_numpy(sequence_scalars(clip.frame(0))[0])
    squares, fresh, pixels = torch.zeros(3), 0.0, 0
    for index in range(len(clip)):
        frame = clip.frame(index).torch()
        result = session.step(frame, ("glossy_alpha",))
        if index == 0:
            continue
        where = f"{spec} on {clip.folder}, frame {index}"
        truth = read_truth(frame, "glossy", exposure, where)
        error = displayed(result.image, "glossy", exposure, where, frame.size) - truth.image
        glossy = regions_of(frame, None)["glossy"].float()
        # Weighted with the region, so that pixels outside it do not enter.
        kept = box_mean(error * glossy, WINDOW) / box_mean(glossy, WINDOW).clamp(min=1e-6)
        parts = (error, kept, error - kept)
        squares += torch.stack([(glossy * part.square().mean(1, keepdim=True)).sum() for part in parts])
        fresh += float((glossy * (result.extras["glossy_alpha"] == 1)).sum())
        pixels += int(glossy.sum())
    return torch.cat([(squares / pixels).sqrt(), torch.tensor([fresh / pixels])])


def main(arguments: Sequence[str]) -> None:
    """Print a row for each clip and kind of vectors."""
    parser = make_parser(__doc__)
    parser.add_argument("clips", nargs="+", type=Path, metavar="CLIP")
    rows = []
    for clip in map(Clip, parser.parse_args(arguments).clips):
        for title, spec in VECTORS.items():
            rows.append([clip.folder.name, title, *(f"{value:.4f}" for value in errors(clip, spec).tolist())])
    heads = ["clip", "vectors", "RMSE", "kept by 7×7", "removed by 7×7", "without history"]
    print(aligned([[head, *column] for head, column in zip(heads, zip(*rows, strict=True), strict=True)]))


if __name__ == "__main__":
    run(main)
