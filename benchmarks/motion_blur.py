"""Motion blur from one sample per pixel, compared with brute force and with post-processes on sharp frames.

    nte render datasets/motion_blur_60.yaml --out data/motion_blur_60
    python -m benchmarks.motion_blur data/motion_blur_60 [--frames 60] [--split test] [--rows NAME …]
        [--json FILE] [--pictures FOLDER]
    python -m benchmarks.motion_blur --times        time against the share of the image that moves

Returns 1 if the filter's FLIP is not below both post-processes' in `crossing`. docs/motion_blur.md says how each number
is computed.
"""

import json
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch
from omegaconf import OmegaConf
from torch import Tensor

from benchmarks.command import count, make_parser, run
from benchmarks.record import record
from nte.color import display
from nte.evaluation.metrics import flip_map
from nte.evaluation.report.strips import most_different
from nte.filters.motion_blur import MotionBlur
from nte.filters.motion_blur.samples import MOVING_PX, near_moving
from nte.frames.clip import Clip
from nte.frames.frame import Frame
from nte.frames.scalars import estimate_exposure
from nte.frames.show import RGB, Picture, grid, quantise, write_png
from nte.registry import load_denoiser
from nte.session import Session
from nte.text_table import aligned

PROMISED = "crossing"
OURS, PAPER, POST = "motion_blur", "motion_blur:preset=paper", ("post_blur", "mcguire")
ROWS = {
    "noisy": "noisy",
    "post_blur": "post_blur",
    "mcguire": "mcguire",
    OURS: OURS,
    "no history": f"{OURS}:history=false",
    "one iteration": f"{OURS}:iterations=1",
    "fixed steps": f"{OURS}:steps=fixed",
    "naive angle": f"{OURS}:angle=naive",
    "with pre-filter": f"{OURS}:prefilter=true",
    "plain share": f"{OURS}:factor=share",
    "static reprojected": f"{OURS}:static=reprojected",
    "as the paper": PAPER,
    "paper, no pre-filter": f"{PAPER},prefilter=false",
    "paper, no history": f"{PAPER},history=false",
    "paper, one iteration": f"{PAPER},iterations=1",
    "paper, fixed steps": f"{PAPER},steps=fixed",
    "paper, naive angle": f"{PAPER},angle=naive",
}
DRAWN = ("post_blur", "mcguire", OURS, "as the paper")  # in the plots and strips
Curve = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Score:
    """The score of one method on one clip: FLIP of each frame but the first."""

    case: str
    method: str
    flip: list[float]  # mean over the image
    median: list[float]  # weighted median of the FLIP map
    moving: list[float]  # mean over pixels with a moving sample within 15×15, where there are any
    milliseconds: float  # per frame

    def mean(self, name: str) -> float:
        values = getattr(self, name)
        return float(np.mean(values)) if values else float("nan")


def weighted_median(errors: Tensor) -> float:
    """Return FLIP's own summary: the errors above this value sum to as much as the errors below it."""
    ordered = errors.flatten().double().sort().values
    sums = ordered.cumsum(0)
    if not sums[-1]:
        return 0.0
    return float(ordered[torch.searchsorted(sums, sums[-1] / 2)])


def cases(folder: Path, split: str) -> dict[str, tuple[Clip, Clip]]:
    """Return case → the blurred clip and its sharp twin, in the order of the recipe in the folder."""
    groups = OmegaConf.load(folder / "recipe.yaml")[split]
    found = {}
    for number, group in enumerate(groups):
        name = f"motion_blur_{number:03d}"
        if (folder / "sharp" / split / name / "clip.json").is_file():
            found[group.parameters.case] = Clip(folder / split / name), Clip(folder / "sharp" / split / name)
    return found


def judge(
    case: str, method: str, frames: list[Frame], references: list[Tensor], exposure: Tensor, near: list[Tensor]
) -> tuple[Score, list[Tensor]]:
    """Return the score of a method on its input, and its images (1, 3, H, W)."""
    session = Session(load_denoiser(ROWS[method]))
    images, start = [], time.perf_counter()
    for frame in frames:
        images.append(torch.as_tensor(session.denoise(frame)))
    spent = (time.perf_counter() - start) / len(frames) * 1e3
    maps = [
        flip_map(display(image, exposure), display(reference, exposure))
        for image, reference in zip(images[1:], references[1:], strict=True)
    ]
    moving = [float(errors[mask].mean()) for errors, mask in zip(maps, near[1:], strict=True) if mask.any()]
    means = [float(errors.mean()) for errors in maps]
    return Score(case, method, means, [weighted_median(m) for m in maps], moving, spent), images


def strip(case: str, images: dict[str, RGB], number: int) -> RGB:
    """Draw reference, input and outputs, each above the crop in which the outputs differ most."""
    corner, size = most_different([pixels for name, pixels in images.items() if name not in ("reference", "noisy")])
    rows, columns = (slice(start, start + length) for start, length in zip(corner, size, strict=True))
    whole = [Picture(name, pixels, f"{case}, frame {number}") for name, pixels in images.items()]
    crops = [Picture("", pixels[rows, columns].repeat(4, 0).repeat(4, 1)) for pixels in images.values()]
    return grid([*whole, *crops], columns=len(images))


def plot(case: str, scores: list[Score], path: Path) -> None:
    """Plot FLIP over the frames, as in the paper's Fig. 12: the mean, and dashed the weighted median."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(7, 3.2))
    for number, score in enumerate(scores):
        frames = np.arange(1, len(score.flip) + 1)
        axes.plot(frames, score.flip, color=f"C{number}", label=score.method)
        axes.plot(frames, score.median, "--", color=f"C{number}", linewidth=0.8)
    axes.set(xlabel="frame", ylabel="FLIP (dashed: weighted median)", title=case, ylim=(0, None))
    axes.legend(fontsize=8)
    figure.tight_layout()
    figure.savefig(path, dpi=110)
    plt.close(figure)


def compare(folder: Path, split: str, count: int, rows: list[str], pictures: Path | None) -> list[Score]:
    """Score every method on every case of a rendered recipe."""
    scores = []
    for case, (blurred, sharp) in cases(folder, split).items():
        length = min(count, len(blurred))
        frames, sharps = ([clip.frame(i).torch() for i in range(length)] for clip in (blurred, sharp))
        references = [frame["reference"] for frame in frames]
        exposure = torch.from_numpy(estimate_exposure(references[0].numpy()))
        near = [near_moving((f["shutter_motion"].square().sum(1, keepdim=True) > MOVING_PX**2).float()) for f in frames]
        # The strip shows the frame in which most pixels move, never the first.
        number = 1 + int(np.argmax([float(mask.float().mean()) for mask in near[1:]]))
        shown = {"reference": references[number], "noisy": frames[number]["color"]}
        for method in rows:
            given = sharps if method in POST else frames
            score, images = judge(case, method, given, references, exposure, near)
            scores.append(score)
            if method in DRAWN:
                shown[method] = images[number]
            print(f"{case}: {method}, {score.mean('flip'):.4f}", file=sys.stderr, flush=True)
        if pictures:
            pictures.mkdir(parents=True, exist_ok=True)
            drawn = {name: quantise(display(image, exposure)[0].numpy()) for name, image in shown.items()}
            write_png(pictures / f"{case}.png", strip(case, drawn, number))
            plot(case, [s for s in scores if s.case == case and s.method in DRAWN], pictures / f"{case}_flip.png")
    return scores


def times(size: int, repeats: int = 3) -> list[tuple[float, float]]:
    """Return (share of the image that is filtered, ms per frame) of square images whose left part moves."""
    rng = np.random.default_rng(0)
    found = []
    for share in (0, 1 / 8, 1 / 4, 1 / 2, 3 / 4, 1):
        moves = np.arange(size) < share * size
        motion = np.broadcast_to(np.where(moves, np.reshape([9.0, 2.0], (2, 1, 1)), 0)[None], (1, 2, size, size))
        channels = {
            "color": rng.random((1, 3, size, size)),
            "time": rng.random((1, 1, size, size)),
            "shutter_motion": motion,
            "shutter_depth": np.ones((1, 1, size, size)),
        }
        frame = Frame({name: values.astype(np.float32) for name, values in channels.items()}).torch()
        denoiser, spent = MotionBlur(), []
        _, state = denoiser.step(frame, None)
        for _ in range(repeats):
            start = time.perf_counter()
            denoiser.step(frame, state)
            spent.append(time.perf_counter() - start)
        area = float(near_moving((frame["shutter_motion"][:, :1] > 0).float()).float().mean())
        found.append((area, min(spent) * 1e3))
    return found


def table(scores: list[Score]) -> str:
    """Format the scores: a row per method, a column per case.

    A cell has the mean FLIP of the image, the mean FLIP near what moves, and the weighted median.
    """
    names = list(dict.fromkeys(score.case for score in scores))
    methods = list(dict.fromkeys(score.method for score in scores))
    by = {(score.case, score.method): score for score in scores}
    columns = [["method", *methods]]
    for name in names:
        cells = [by[name, m] for m in methods]
        columns.append(
            [name, *(f"{s.mean('flip'):.4f} / {s.mean('moving'):.4f} / {s.mean('median'):.3f}" for s in cells)]
        )
    spent = [np.mean([by[name, m].milliseconds for name in names]) for m in methods]
    return aligned([*columns, ["ms/frame", *(f"{ms:.0f}" for ms in spent)]])


def main(arguments: Sequence[str]) -> int:
    parser = make_parser(__doc__)
    parser.add_argument("folder", type=Path, nargs="?")
    parser.add_argument("--split", default="test")
    parser.add_argument("--frames", type=count, default=60)
    parser.add_argument("--rows", nargs="*", default=list(ROWS), metavar="NAME", help=", ".join(ROWS))
    parser.add_argument("--times", action="store_true")
    parser.add_argument("--size", type=count, default=512, help="of the image for --times")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--pictures", type=Path)
    given = parser.parse_args(arguments)
    if unknown := [name for name in given.rows if name not in ROWS]:
        parser.error(f"no row {unknown[0]!r}: expected some of {', '.join(ROWS)}")
    if given.times:
        found = times(given.size)
        still, everything = found[0][1], found[-1][1]
        record("motion_blur", {f"{area:.0%} filtered, {given.size}×{given.size}": ms for area, ms in found}, "ms")
        print(f"{given.size}×{given.size}, {torch.get_num_threads()} threads")
        columns = [["filtered", *(f"{area:.1%}" for area, _ in found)], ["ms", *(f"{ms:.1f}" for _, ms in found)]]
        print(aligned([*columns, ["of all", *(f"{ms / everything:.2f}" for _, ms in found)]]))
        print(f"nothing moves: {everything / still:.0f} times less than all of it")
    if not given.folder:
        return 0
    scores = compare(given.folder, given.split, given.frames, given.rows, given.pictures)
    print(f"mean FLIP / near what moves / weighted median, {given.split} clips, first frame left out")
    print(table(scores))
    if given.json:
        given.json.write_text(json.dumps([asdict(score) for score in scores], indent=1))
    means = {score.method: score.mean("flip") for score in scores if score.case == PROMISED}
    return int(any(means[post] <= means[OURS] for post in POST if {post, OURS} <= means.keys()))


if __name__ == "__main__":
    run(main)
