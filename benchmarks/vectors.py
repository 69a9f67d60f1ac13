"""Gain of reliable over traditional motion vectors: how much closer they bring clean history to the current frame.

    python -m benchmarks.vectors [SITUATION …] [--clips 8] [--size 128] [--json FILE] [--pictures FOLDER]

Returns 1 if in a situation that the project promises the margin's interval includes zero. docs/vectors.md says how each
number is computed.
"""

import json
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from benchmarks.command import count, make_parser, run
from benchmarks.fetched import Fetched, draw, fetch, fill, is_planar
from nte.color import demodulate
from nte.evaluation.bootstrap import bootstrap_interval
from nte.evaluation.metrics import SHADOWED
from nte.filters.bilateral import ROUGHNESS
from nte.frames.scalars import estimate_exposure
from nte.frames.show import Picture, grid, heat, quantise, write_png
from nte.motion.geometric import dual_motion
from nte.motion.warp import fetch_nearest, pixel_centres
from nte.render.components.frame import references, reflection_samples, shadow_samples
from nte.render.engine.mesh_stage import MeshStage
from nte.render.passes.gbuffer import guides
from nte.render.recipes.recipe import ClipPlan, Group, make_scene
from nte.render.world.seeds import derive_seed
from nte.text_table import aligned

TIME = 4  # the frame whose history is fetched from the previous frame
FOOTPRINT = 4  # px: a sample without a vector takes the mean of the vectors around it
Channels = dict[str, Tensor]  # (1, C, H, W)


@dataclass(frozen=True)
class Situation:
    """Clips of one kind, the light component that is fetched, and the region in which a gain is promised."""

    scene: str
    light: str
    promised: str | None
    parameters: dict[str, Any] = field(default_factory=dict)


SITUATIONS = {
    "fence": Situation("fence", "visibility", "shadowed"),
    "apples": Situation("apples", "visibility", "shadowed"),
    "pinkroom": Situation("pinkroom", "visibility", "shadowed"),
    "temple": Situation("temple", "glossy", "glossy", {"speed": 2.0, "roughness": 0.05}),
    "restaurant": Situation("restaurant", "glossy", "planar", {"speed": 2.0, "roughness": 0.05}),
    "pica": Situation("pica", "indirect", "disoccluded"),
    "temple, as it is": Situation("temple", "glossy", None),
    "restaurant, as it is": Situation("restaurant", "glossy", None),
}


@dataclass(frozen=True)
class Case:
    """What is compared: clean history and the clean current frame, and the vectors between them."""

    history: Tensor  # (1, C, H, W)
    now: Tensor  # (1, C, H, W)
    noise: Tensor  # (1, C, H, W) deviates like the difference of two references
    traditional: Tensor  # (1, 2, H, W)
    reliable: Tensor  # (S, 2, H, W)
    usable: Tensor  # (1, 1, H, W) bool: the reliable vectors end inside the image, as far as is known here
    regions: dict[str, Tensor]  # (1, 1, H, W) bool


@dataclass(frozen=True)
class Score:
    """Means over a region of one clip."""

    share: float  # of the image that the region covers
    left_out: float  # share of the region's samples that either vector fetches from outside the previous image
    noise: float  # the error of a perfect vector, because references have noise
    traditional: float
    reliable: float  # expected error of one sample
    reliable_mean: float  # error of the mean of what the samples fetch

    @property
    def margin(self) -> float:
        return self.traditional - self.reliable


def render(
    situation: Situation, split: str, number: int, size: int, spp: int, samples: int
) -> tuple[Channels, Channels]:
    """Render the clean previous and current frames of a clip.

    The current frame also has the vectors' samples, (S, C, H, W).
    """
    group = Group(scene=situation.scene, parameters=situation.parameters, clips=1, width=size, height=size)
    unit = ClipPlan("vectors", 0, split, number, group)
    stage = MeshStage(make_scene(unit), size, size, group.max_depth)
    frames = []
    for when in (TIME - 1, TIME):
        seeds = ((derive_seed(unit.name, when, half), derive_seed(unit.name, when, half + 2)) for half in (0, 1))
        with stage.at(when) as moment:
            channels = guides(moment)
            a, b = (references(moment, spp // 2, pair) for pair in seeds)
        channels |= {name: (a[name] + b[name]) / 2 for name in a} | {f"{name} noise": a[name] - b[name] for name in a}
        frames.append({name: torch.from_numpy(np.array(values))[None] for name, values in channels.items()})
    frames[1] |= vector_samples(stage, situation.light, [derive_seed(unit.name, "sample", n) for n in range(samples)])
    return frames[0], frames[1]


def vector_samples(stage: MeshStage, light: str, seeds: list[int]) -> Channels:
    """Render the random vectors of a component, (S, C, H, W); nothing for indirect light, whose vectors are known."""
    if light == "visibility":
        with stage.at(TIME) as moment:
            return {"shadow_motion": torch.from_numpy(np.stack(shadow_samples(moment, seeds)))}
    if light == "glossy":
        motion, covariance = (np.stack(values) for values in zip(*reflection_samples(stage, TIME, seeds), strict=True))
        return {"reflection_motion": torch.from_numpy(motion), "reflection_covariance": torch.from_numpy(covariance)}
    return {}


def shadows(before: Channels, now: Channels) -> Case:
    """Make the case of visibility, where the reference has shadow or penumbra."""
    name = "reference_visibility"
    vectors = fill(now["shadow_motion"], now["instance"], FOOTPRINT)
    regions = {"shadowed": now[name] < SHADOWED}
    return Case(before[name], now[name], now[f"{name} noise"], now["motion"], *_completed(vectors, now), regions)


def reflections(before: Channels, now: Channels) -> Case:
    """Make the case of exposed glossy light, wherever another lobe than the diffuse one reflected a sample."""
    name = "reference_glossy"
    exposure = float(estimate_exposure(((now["reference_a"] + now["reference_b"]) / 2).numpy())[0])
    lobes = torch.cat([now["reflection_motion"], now["reflection_covariance"]], 1)
    glossy = lobes.isfinite().all(1, keepdim=True).any(0, keepdim=True)
    lobes = fill(lobes, now["instance"], FOOTPRINT)
    vectors = draw(lobes[:, :2], lobes[:, 2:], torch.Generator().manual_seed(0))
    # As in `trmv`: a place that another surface has taken reflects something else, or nothing at all.
    place = (pixel_centres(vectors) + vectors).nan_to_num()
    there = fetch_nearest(before["roughness"].expand(len(vectors), -1, -1, -1), place)
    vectors = torch.where((there - now["roughness"]).abs() < ROUGHNESS, vectors, torch.nan)
    planar = is_planar(now["normal"], now["instance"])
    regions = {"glossy": glossy, "planar": glossy & planar, "curved": glossy & ~planar}
    light = (exposure * image for image in (before[name], now[name], now[f"{name} noise"]))
    return Case(*light, now["motion"], *_completed(vectors, now), regions)


def occlusions(before: Channels, now: Channels) -> Case:
    """Make the case of indirect irradiance (indirect light over albedo), where something hid the surface."""
    name = "reference_indirect"
    dual = dual_motion(now["motion"], before["forward_motion"], now["depth"], before["depth"])
    light = [demodulate(f[key], f["albedo"]) for f, key in ((before, name), (now, name), (now, f"{name} noise"))]
    kept = (dual.motion == now["motion"]).all(1, keepdim=True)  # because the dual vector would leave the image
    return Case(*light, now["motion"], dual.motion, ~kept, {"disoccluded": dual.disoccluded})


CASES: dict[str, Callable[[Channels, Channels], Case]] = {
    "visibility": shadows,
    "glossy": reflections,
    "indirect": occlusions,
}


def _completed(vectors: Tensor, now: Channels) -> tuple[Tensor, Tensor]:
    """Vectors with the traditional one where no sample of the footprint has a vector, as a filter uses them."""
    known = vectors.isfinite().all(1, keepdim=True)
    return torch.where(known, vectors, now["motion"]), torch.ones_like(known[:1])


def measure(case: Case) -> tuple[dict[str, Score], dict[str, Fetched]]:
    """Return the score in every region that exists, and what was fetched."""
    found = {
        "traditional": fetch(case.history, case.now, case.traditional),
        "reliable": fetch(case.history, case.now, case.reliable),
    }
    inside = found["traditional"].inside * found["reliable"].inside * case.usable
    maps = {
        "noise": case.noise.abs().mean(1, keepdim=True) / 2**0.5,
        "traditional": found["traditional"].error,
        "reliable": found["reliable"].error,
        "reliable_mean": found["reliable"].error_of_mean(case.now),
    }
    scores = {}
    for name, region in case.regions.items():
        used = region & (inside > 0)
        if used.any():
            means = {key: values[used].mean().item() for key, values in maps.items()}
            share, left_out = region.float().mean().item(), 1 - inside[region].mean().item()
            scores[name] = Score(share, left_out, **means)
    return scores, found


def picture(case: Case, found: dict[str, Fetched]) -> np.ndarray:
    """Draw before, now, what both vectors fetch (mean over samples), and the errors in one scale, (H, W, 3)."""
    scale = 1.0 if case.now.shape[1] == 1 else np.quantile(case.now.numpy(), 0.98)
    images = {"before": case.history, "now": case.now} | {name: fetched.image for name, fetched in found.items()}
    errors = {f"{name}: expected error": fetched.error for name, fetched in found.items()}
    inside = (found["traditional"].inside > 0) & case.usable
    cells = [Picture(name, quantise((image[0] / scale).numpy() ** (1 / 2.2))) for name, image in images.items()]
    for name, error in errors.items():
        drawn = heat((error / scale * 2)[0, 0].numpy())
        cells.append(Picture(name, quantise(drawn), f"yellow: {scale / 2:.2g}"))
    for name, region in case.regions.items():
        cells.append(Picture(name, quantise((region & inside)[0].float().numpy()), "white: counted"))
    return grid(cells, columns=4)


@dataclass(frozen=True)
class Row:
    """One line of the table: a region over all clips of a situation."""

    situation: str
    region: str
    promised: bool
    clips: list[Score]

    def mean(self, name: str) -> float:
        return float(np.mean([getattr(score, name) for score in self.clips]))

    def interval(self) -> tuple[float, float]:
        return bootstrap_interval([score.margin for score in self.clips])

    def as_dict(self) -> dict[str, Any]:
        return {**asdict(self), "margin": self.mean("margin"), "interval": self.interval()}


def table(rows: list[Row]) -> str:
    columns: dict[str, Callable[[Row], str]] = {
        "situation": lambda row: f"{row.situation}, {row.region}" + (" *" if row.promised else ""),
        "clips": lambda row: str(len(row.clips)),
        "pixels": lambda row: f"{row.mean('share'):.1%}",
        "left out": lambda row: f"{row.mean('left_out'):.1%}",
        "noise": lambda row: f"{row.mean('noise'):.4f}",
        "traditional": lambda row: f"{row.mean('traditional'):.4f}",
        "reliable": lambda row: f"{row.mean('reliable'):.4f}",
        "ratio": lambda row: f"{row.mean('traditional') / row.mean('reliable'):.2f}",
        "of mean": lambda row: f"{row.mean('reliable_mean'):.4f}",
        "ratio ": lambda row: f"{row.mean('traditional') / row.mean('reliable_mean'):.2f}",
        "margin": lambda row: f"{row.mean('margin'):.4f}",
        "95 % interval": lambda row: "{:.4f} … {:.4f}".format(*row.interval()),
    }
    return aligned([[title, *map(text, rows)] for title, text in columns.items()])


def main(arguments: Sequence[str]) -> int:
    parser = make_parser(__doc__)
    parser.add_argument("situations", nargs="*", metavar="SITUATION", help=", ".join(SITUATIONS))
    parser.add_argument("--clips", type=count, default=8)
    parser.add_argument("--size", type=count, default=128)
    parser.add_argument("--spp", type=count, default=256, help="of the clean frames")
    parser.add_argument("--samples", type=count, default=64, help="of the vectors")
    parser.add_argument("--split", choices=("test", "train"), default="test", help="train: to try things out")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--pictures", type=Path)
    given = parser.parse_args(arguments)
    if unknown := [name for name in given.situations if name not in SITUATIONS]:
        parser.error(f"no situation {unknown[0]!r}: expected one of {', '.join(SITUATIONS)}")
    rows: list[Row] = []
    for name in given.situations or SITUATIONS:
        situation, scores, earlier = SITUATIONS[name], {}, rows
        for number in range(given.clips):
            start = time.perf_counter()
            frames = render(situation, given.split, number, given.size, given.spp, given.samples)
            case = CASES[situation.light](*frames)
            found_scores, found = measure(case)
            for region, score in found_scores.items():
                scores.setdefault(region, []).append(score)
            if given.pictures and number == 0:
                given.pictures.mkdir(parents=True, exist_ok=True)
                write_png(given.pictures / f"{name.replace(', ', '_').replace(' ', '_')}.png", picture(case, found))
            mine = [Row(name, region, region == situation.promised, clips) for region, clips in scores.items()]
            rows = earlier + mine
            if given.json:  # after every clip, because a clip takes minutes
                given.json.write_text(json.dumps([row.as_dict() for row in rows], indent=1))
            seconds = time.perf_counter() - start
            print(f"{name}: clip {number + 1} of {given.clips}, {seconds:.0f} s", file=sys.stderr, flush=True)
    print(f"{given.size}×{given.size}, {given.spp} spp, {given.samples} samples of the vectors; * promised")
    print(table(rows))
    return int(any(row.promised and row.interval()[0] <= 0 for row in rows))


if __name__ == "__main__":
    run(main)
