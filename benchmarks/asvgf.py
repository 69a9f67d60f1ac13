"""Effect of A-SVGF on each light component: which gradient it uses, and by what rule it shortens history.

    nte render datasets/asvgf.yaml --out data/asvgf
    python -m benchmarks.asvgf data/asvgf

Prints RMSE of x/(1 + x) / mean history length in frames, over the frames from the fourth on.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple
from unittest.mock import patch

import numpy as np
from torch import Tensor

from benchmarks.command import make_parser, run
from nte.filters import asvgf
from nte.filters.composition import COMPONENTS
from nte.filters.moments import shorten
from nte.frames.clip import Clip
from nte.frames.clip_files import find_clips
from nte.frames.frame import Frame
from nte.registry import load_denoiser
from nte.session import Session
from nte.text_table import aligned

FIRST = 3  # number of frames that only build up history


class Variant(NamedTuple):
    """A column of the table: a filter, its rule for shortening history, and which gradients it reads.

    own: the components' own gradients, instead of the gradient of all light.
    """

    spec: str
    rule: Callable[[Tensor, Tensor], Tensor] = shorten
    own: bool = True


VARIANTS = {
    "SVGF": Variant("svgf"),
    "A-SVGF": Variant("asvgf"),
    "gradient of all light": Variant("asvgf", own=False),
    "gradient_noise=1": Variant("asvgf:gradient_noise=1"),
    "length 1/α": Variant("asvgf", lambda length, change: length / (1 + change * (length - 1))),
    "length · (1 − λ)^10": Variant("asvgf", lambda length, change: (length - 1) * (1 - change) ** 10 + 1),
    "length kept": Variant("asvgf", lambda length, change: length),
}


def measure(clip: Clip, target: str, variant: Variant) -> str:
    """Return RMSE / history length of one variant on one component of a clip."""
    name, _, options = variant.spec.partition(":")
    session = Session(load_denoiser(f"{name}:target={target},{options}"))
    errors, lengths = [], []
    with patch.object(asvgf, "shorten", variant.rule):
        for index, frame in enumerate(clip):
            hidden = () if variant.own else tuple(f"gradient_{name}" for name in COMPONENTS)
            seen = {name: values for name, values in frame.channels.items() if name not in hidden}
            result = session.step(Frame(seen, index), ("history_length",))
            if index >= FIRST:
                errors.append(rmse(result.image, frame[f"reference_{target}"]))
                lengths.append(float(result.extras["history_length"].mean()))
    return f"{np.mean(errors):.4f} / {np.mean(lengths):.1f}"


def rmse(image: Any, reference: Any) -> float:
    """Return the RMSE of x/(1 + x)."""
    return float(np.sqrt(np.square(image / (1 + image) - reference / (1 + reference)).mean()))


def main(arguments: Sequence[str]) -> None:
    """Print the table: one row for each component that has light in a clip."""
    parser = make_parser(__doc__)
    parser.add_argument("folders", nargs="+", type=Path, metavar="CLIP_OR_FOLDER")
    folders = parser.parse_args(arguments).folders
    columns: list[list[str]] = [["clip, light"], *([name] for name in VARIANTS)]
    for clip in map(Clip, find_clips(folders)):
        for target in COMPONENTS:
            if not clip.frame(0)[f"reference_{target}"].any():
                continue
            columns[0].append(f"{clip.name}, {target}")
            for column, variant in zip(columns[1:], VARIANTS.values(), strict=True):
                column.append(measure(clip, target, variant))
    print(aligned(columns))


if __name__ == "__main__":
    run(main)
