"""Which motion, found in noisy images alone, brings the clean previous frame closest to the clean current one?

    nte render datasets/correspondence.yaml --out data/correspondence
    python tests/benchmarks/correspondence.py data/correspondence/test [--times] [--ablations] [--json FILE]
        [--pictures FOLDER]

Returns 1 if something that the project promises does not hold. docs/correspondence.md says how numbers are computed.
"""

import argparse
import json
import sys
import warnings
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from nte.color import display
from nte.denoiser import Session
from nte.evaluation.flow_costs import cost_table, costs, pass_table, passes
from nte.evaluation.flows import FLOWS, Find, noise_of, ours, searching, zero
from nte.evaluation.table import aligned
from nte.filters.align_accumulate import AlignAccumulate
from nte.filters.estimated import matched_grey
from nte.frames.clip import Clip, find_clips
from nte.frames.frame import Frame
from nte.frames.scalars import estimate_exposure
from nte.frames.show import Picture, grid, heat, quantise, write_png
from nte.motion.correspondence import RADII, SEARCHES, FewerLevelsWarning, Search
from nte.motion.warp import warp

PAPER_SPP = {"penumbra": 4, "subsurface": 50}  # of Hanika et al. 2021; the others have 1
SCENES = ("spheres", "dining", "ocean", "cloud", "penumbra", "subsurface")
CHANGING = ("ocean", "cloud", "penumbra", "subsurface")  # where accumulation with estimated motion must be best
MARGIN = 1.1  # nowhere more than this times the best method's error
_PLAIN, _NOISY, _MODERATE = Search(RADII["noisy"]), SEARCHES["noisy"], SEARCHES["moderate"]
ABLATIONS = {
    "paper's radii, L1": replace(_PLAIN, norm="l1"),
    "paper's radii": _PLAIN,
    "noisy, full, without both": replace(_NOISY, smoothing=(), agreement=(), half=False),
    "noisy without both": replace(_NOISY, smoothing=(), agreement=()),
    "noisy without agreement": replace(_NOISY, agreement=()),
    "noisy, full": replace(_NOISY, half=False),
    "noisy": _NOISY,
    "noisy, L1": replace(_NOISY, norm="l1"),
    "moderate without both": replace(_MODERATE, smoothing=(), agreement=()),
    "moderate without agreement": replace(_MODERATE, agreement=()),
    "moderate": _MODERATE,
    "moderate, agreement also at full size": replace(_MODERATE, agreement=(4, 4)),
}


class Pair(NamedTuple):
    """What is searched, and what is compared."""

    current: Tensor  # (1, 1, H, W) noisy
    previous: Tensor
    now: Tensor  # (1, 3, H, W) clean, displayed
    before: Tensor


def methods(noise: str, without: list[str], ablations: bool) -> dict[str, Find]:
    if ablations:
        return {"zero": zero, "DIS": FLOWS["DIS"], **{name: searching(search) for name, search in ABLATIONS.items()}}
    mine = {"ours": ours(noise), "ours, full": ours(noise, False), "ours, half": ours(noise, True)}
    return {name: find for name, find in {"zero": zero, **FLOWS, **mine}.items() if name not in without}


def error(pair: Pair, motion: Tensor) -> float:
    """Mean |warped previous − current| of the displayed references."""
    return float((warp(pair.before, motion).image - pair.now).abs().mean())


def read(folder: Path, samples: int) -> tuple[list[Frame], Tensor]:
    """The frames with the mean of so many noise seeds, and the exposure (1,) of the first."""
    clip = Clip(folder)
    wanted = [name for name in ("color", "reference", "motion", "albedo") if name in clip.channels]
    frames = [clip.frame(i, wanted, range(samples)).torch() for i in range(len(clip))]
    return frames, torch.from_numpy(estimate_exposure(frames[0]["color"].numpy()))


def pairs(frames: list[Frame], exposure: Tensor) -> list[Pair]:
    made = [(matched_grey(f["color"], exposure), display(f["reference"], exposure)) for f in frames]
    return [Pair(now[0], before[0], now[1], before[1]) for before, now in pairwise(made)]


def discs(deviation: float, count: int = 3, size: int = 256) -> list[Pair]:
    """A shaded disc that moves by (6, 2) px a frame, with Gaussian noise of this deviation (Figure 6 of the paper)."""
    rows, columns = torch.meshgrid(torch.arange(size) + 0.5, torch.arange(size) + 0.5, indexing="ij")
    clean = []
    for i in range(count + 1):
        dx, dy = columns - 100 - 6 * i, rows - 120 - 2 * i
        inside = (50.5 - (dx * dx + dy * dy).sqrt()).clamp(0, 1)
        clean.append((inside * (0.7 + 0.2 * dx / 50))[None, None])
    generator = torch.Generator().manual_seed(0)
    noisy = [(c + deviation * torch.randn(c.shape, generator=generator)).clamp(0, 1) for c in clean]
    return [Pair(noisy[i + 1], noisy[i], clean[i + 1], clean[i]) for i in range(count)]


def accumulations(frames: list[Frame], exposure: Tensor, noise: str) -> dict[str, float]:
    """PSNR with each motion, and with estimated motion of demodulated light."""
    by_motion = {m: accumulation(frames, exposure, noise, m) for m in ("estimate", "zero", "geometric")}
    return by_motion | {"demodulated": accumulation(frames, exposure, noise, "estimate", True)}


def accumulation(frames: list[Frame], exposure: Tensor, noise: str, motion: str, demodulate: bool = False) -> float:
    """Mean PSNR of the displayed image, without the first frame."""
    session = Session(AlignAccumulate(motion, noise, demodulate=demodulate))
    values = []
    for frame in frames:
        image = display(session.denoise(frame), exposure)
        mse = (image - display(frame["reference"], exposure)).square().mean()
        values.append(float(-10 * torch.log10(mse)))
    return float(np.mean(values[1:]))


def picture(pair: Pair, found: dict[str, Tensor]) -> np.ndarray:
    cells = [Picture("searched", quantise(pair.current[0].numpy())), Picture("clean", quantise(pair.now[0].numpy()))]
    for name, motion in found.items():
        apart = (warp(pair.before, motion).image - pair.now).abs().mean(1)[0]
        cells.append(Picture(name, quantise(heat((apart * 5).numpy(), "magma")), f"error {error(pair, motion):.4f}"))
    return grid(cells, columns=4)


def main(arguments: list[str]) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("clips", nargs="*", type=Path)
    parser.add_argument("--times", action="store_true", help="time and memory too")
    parser.add_argument("--without", nargs="+", default=[], metavar="METHOD", help="Dual TV-L1 takes most of the time")
    parser.add_argument("--ablations", action="store_true", help="our searches with and without their parts")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--pictures", type=Path)
    given = parser.parse_args(arguments)
    warnings.simplefilter("ignore", FewerLevelsWarning)
    cases: dict[str, tuple[list[Pair], str]] = {}
    by_clip: dict[str, list[dict[str, float]]] = {}
    for folder in find_clips(given.clips) if given.clips else []:
        scene = folder.name.rpartition("_")[0]
        info = Clip(folder).info
        spp, seeds = info["spp"], info.get("seeds", 1)
        for samples in sorted({seeds, 1}, reverse=True):
            frames, exposure = read(folder, samples)
            noise = noise_of(spp * samples)
            name = f"{scene}, {spp * samples} spp"
            cases.setdefault(name, ([], noise))[0].extend(pairs(frames, exposure))
            by_clip.setdefault(name, []).append(accumulations(frames, exposure, noise))
    merged = {name: {m: float(np.mean([c[m] for c in clips])) for m in clips[0]} for name, clips in by_clip.items()}
    cases |= {"disc, 2 %": (discs(0.02), "moderate"), "disc, 10 %": (discs(0.1), "noisy")}
    scores: dict[str, dict[str, float]] = {}
    for name, (all_pairs, noise) in cases.items():
        found = {
            method: [find(p.current, p.previous) for p in all_pairs]
            for method, find in methods(noise, given.without, given.ablations).items()
        }
        scores[name] = {
            m: float(np.mean([error(*both) for both in zip(all_pairs, motions, strict=True)]))
            for m, motions in found.items()
        }
        if given.pictures:
            given.pictures.mkdir(parents=True, exist_ok=True)
            path = given.pictures / f"{name.replace(', ', '_').replace(' ', '_').replace('%', 'percent')}.png"
            write_png(path, picture(all_pairs[-1], {m: f[-1] for m, f in found.items()}))
        print(f"{name}: {scores[name]}", file=sys.stderr, flush=True)
    print("Mean |warped previous − current| of the clean, displayed images")
    print(", ".join(f"{name}: {len(all_pairs)} pairs" for name, (all_pairs, _) in cases.items()))
    columns = [[m, *(f"{row[m]:.4f}" for row in scores.values())] for m in next(iter(scores.values()))]
    print(aligned([["", *scores], *columns]))
    if given.ablations:
        return 0
    failures = verdicts(scores, merged)
    if merged:
        print("\nPSNR of accumulation (align_accumulate) by its motion, dB")
        columns = [[m, *(f"{row[m]:.2f}" for row in merged.values())] for m in next(iter(merged.values()))]
        print(aligned([["", *merged], *columns]))
    measured: dict[str, Any] = {"warped": scores, "accumulation": merged}
    if given.times:
        measured["costs"], measured["passes"] = costs(), passes()
        print(f"\n{cost_table(measured['costs'])}\n\n{pass_table(measured['passes'])}")
        failures += limits_exceeded(measured["costs"])
    for line in failures:
        print(f"does not hold: {line}")
    if given.json:
        given.json.write_text(json.dumps(measured, indent=1))
    return int(bool(failures))


def verdicts(scores: dict[str, dict[str, float]], merged: dict[str, dict[str, float]]) -> list[str]:
    """What does not hold of what the project promises, at the paper's noise levels."""
    failures, wins, there = [], 0, 0
    for scene in SCENES:
        name = f"{scene}, {PAPER_SPP.get(scene, 1)} spp"
        if name not in scores:
            continue
        there += 1
        row = scores[name]
        flows = [row[m] for m in FLOWS if m in row]
        best = min(row["zero"], *flows)
        wins += all(row["ours"] < flow for flow in flows)
        if row["ours"] >= row["zero"]:
            failures.append(f"{name}: not better than zero motion")
        if row["ours"] > MARGIN * best:
            failures.append(f"{name}: {row['ours'] / best:.2f} times the best")
        if scene in CHANGING and merged[name]["estimate"] <= max(merged[name]["zero"], merged[name]["geometric"]):
            failures.append(f"{name}: accumulation with estimated motion is not the best")
    print(f"lower than every optical flow in {wins} of {there} scenes")
    if there == len(SCENES) and wins < 4:
        failures.append(f"lower than every optical flow in {wins} scenes only")
    return failures


def limits_exceeded(rows: dict[str, Any]) -> list[str]:
    """What does not hold of the promises about time and memory."""
    failures = []
    farneback = rows["Farnebäck"]["ms"]
    if rows["ours, half"]["ms"] >= farneback:
        failures.append("half resolution is not faster than Farnebäck")
    if rows["ours, full"]["ms"] > 3 * farneback:
        failures.append("full resolution takes more than 3 times as long as Farnebäck")
    for name, limit in (("ours, full", 120), ("ours, half", 60)):
        if rows[name].get("peak_mb", 0.0) >= limit:
            failures.append(f"{name} takes {rows[name]['peak_mb']:.0f} MB, more than {limit}")
    return failures


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
