"""Cost of each of the paper's steps: from our defaults to its constants, one after another, in closed form.

    python -m benchmarks.motion_blur_paper [--scales 1 2]

The blurred frame of both scenes is known: a striped bar that crosses black, and stripes that fill the image and slide,
as under a moving camera. Each scene is drawn at several sizes, with everything in it scaled alike, because the paper's
windows and thresholds are in pixels of a 1920×1080 image. Prints FLIP of the third frame.
"""

from collections.abc import Sequence

import torch

from benchmarks.command import count, make_parser, run
from nte.color import display
from nte.evaluation.metrics import flip_map
from nte.registry import load_denoiser
from nte.session import Session
from nte.text_table import aligned
from tests.filters.bars import Bar

SCENES = {
    "crossing": Bar((16, 24), (12, 4), 0.3, stripes=8.0, image=(56, 64), color=(1.0, 0.7, 0.4)),
    "sideways": Bar((400, 400), (6, 2), 0.3, stripes=8.0, image=(56, 64), color=(1.0, 0.7, 0.4)),
}
STEPS = {
    "ours": "",
    "factor: share of 15×15": "factor=share",
    "static history reprojected": "static=reprojected",
    "history weighs 1": "weight=1",
    "history through the 5×5 kernel": "fetch=kernel",
    "steps not halved": "stretch=1",
    "β of the weight": "beta_a=1,beta_l=10",
    "pre-filter: as the paper": "prefilter=true,near=2.5,jitter=1.5",
}
FRAMES = 3


def scaled(bar: Bar, scale: int) -> Bar:
    """Return the same picture with `scale` times as many pixels along each axis."""
    sizes = {name: tuple(scale * part for part in getattr(bar, name)) for name in ("size", "velocity", "image")}
    return Bar(**{**bar.__dict__, **sizes, "stripes": scale * bar.stripes})


def main(arguments: Sequence[str]) -> int:
    parser = make_parser(__doc__)
    parser.add_argument("--scales", type=count, nargs="+", default=[1, 2])
    given = parser.parse_args(arguments)
    columns = [["step", "noisy", *STEPS]]
    for name, scene in SCENES.items():
        for scale in given.scales:
            bar = scaled(scene, scale)
            frames = [bar.frame(index + 1 - FRAMES).torch() for index in range(FRAMES)]
            raw, truth, exposure = frames[-1]["color"], torch.from_numpy(bar.truth(0))[None], torch.ones(1)
            cells, options = [f"{float(flip_map(display(raw, exposure), display(truth, exposure)).mean()):.3f}"], []
            for step in STEPS.values():
                options += [step] if step else []
                session = Session(load_denoiser("motion_blur" + (":" + ",".join(options) if options else "")))
                image = [session.denoise(frame) for frame in frames][-1]
                error = flip_map(display(image, exposure), display(truth, exposure)).mean()
                cells.append(f"{float(error):.3f}")
            columns.append([f"{name}, {bar.image[1]}x{bar.image[0]}", *cells])
    print(f"FLIP of frame {FRAMES}; each step beside those above it")
    print(aligned(columns))
    return 0


if __name__ == "__main__":
    run(main)
