"""Comparison of motion found in noisy images: which brings the clean previous frame closest to the clean current one?

    python -m benchmarks.correspondence [--recipe FILE] [--data FOLDER] [--fast] [--times] [--json FILE]

Renders the recipe's clips where they are missing, chooses the settings of every method on the train clips, and prints
tables of the test clips. docs/correspondence.md holds the tables, and says how the numbers are computed. Returns 1 if
something that the project promises does not hold.
"""

import json
import sys
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks.command import make_parser, run
from benchmarks.correspondence_cases import (
    Case,
    Pair,
    accumulation,
    by_level,
    constructed,
    from_clip,
    long_clips,
    own_error,
    trust,
)
from benchmarks.flow_costs import cost_table, costs, pass_table, passes
from benchmarks.flows import FLOWS, Find, candidates, ours, zero
from nte.frames.clip_files import find_clips
from nte.motion.correspondence import FewerLevelsWarning
from nte.motion.search import SEARCHES
from nte.render.recipes.clips import render_recipe
from nte.text_table import aligned

MARGIN = 1.1  # our error must nowhere exceed this factor times the best other method's error
PANS = ((24, 9), (48, 18), (80, 30))
MASKS = {"none": (0.0, 0.0), "κ 1, η 0.5": (1.0, 0.5), "κ 2, η 1.6": (2.0, 1.6), "κ 4, η 1.6": (4.0, 1.6)}


def mean(values: list[float]) -> float:
    return float(np.mean(values)) if values else float("nan")


def tune(cases: list[Case], slow: bool) -> dict[str, dict[str, tuple[str, Find]]]:
    """Return method → noise → the best setting's name and the setting itself.

    The best setting has the least mean error over the train cases of that noise.
    """
    chosen: dict[str, dict[str, tuple[str, Find]]] = {}
    for method, settings in candidates(slow).items():
        for noise in sorted({case.noise for case in cases}):
            pairs = [pair for case in cases if case.noise == noise for pair in case.pairs]
            errors = {name: mean([pair.error(find(*pair.images)) for pair in pairs]) for name, find in settings.items()}
            best = min(errors, key=lambda name: errors[name])
            chosen.setdefault(method, {})[noise] = best, settings[best]
            print(f"  {method}, {noise}: {best} of {len(settings)}", flush=True)
    return chosen


def score(case: Case, find: Find) -> tuple[float, float]:
    """Return the mean residual and the mean end-point error of a case; NaN where the truth is unknown."""
    found = [(pair, find(*pair.images)) for pair in case.pairs]
    ends = [pair.end_point(motion) for pair, motion in found if pair.truth is not None]
    return mean([pair.error(motion) for pair, motion in found]), mean(ends)


def compare(cases: list[Case], chosen: dict[str, dict[str, tuple[str, Find]]]) -> list[str]:
    """Print residual and end-point error of every method in every case; return what does not hold."""
    rows: dict[str, dict[str, tuple[float, float]]] = {}
    for case in cases:
        plain = {name: find for name, find in FLOWS.items() if name in chosen}
        tuned = {f"{m}, tuned" if m in FLOWS else m: by.get(case.noise, ("", zero))[1] for m, by in chosen.items()}
        rows[case.name] = {n: score(case, f) for n, f in {"zero": zero, **plain, **tuned, "ours": ours()}.items()}
        print(f"  {case.name}", file=sys.stderr, flush=True)
    methods = list(next(iter(rows.values())))
    for place, title in enumerate(("Mean |warped previous − current|", "Mean end-point error, px")):
        shown = {name: row for name, row in rows.items() if not np.isnan(row["zero"][place])}
        table = [["", *shown], *([m, *(f"{row[m][place]:.4f}" for row in shown.values())] for m in methods)]
        print(f"\n{title}\n{aligned(table)}")
    failures, wins, rendered = [], 0, [name for name in rows if " spp" in name]
    for name in rendered:
        residuals = {m: values[0] for m, values in rows[name].items()}
        others = [value for m, value in residuals.items() if not m.startswith("ours")]
        wins += residuals["ours"] < min(others)
        if residuals["ours"] > MARGIN * min(others):
            failures.append(f"{name}: {residuals['ours'] / min(others):.2f} times the best")
    print(f"\nours has the least residual, all others tuned, in {wins} of {len(rendered)} rendered cases")
    return failures


def pans(pairs: list[tuple[str, Pair]]) -> list[str]:
    """Print how well each preset finds pans of whole images; return those that it does not find."""
    rows, failures = [["", *SEARCHES]], []
    for name, pair in pairs:
        errors = {noise: pair.end_points(ours(noise)(*pair.images)) for noise in SEARCHES}
        rows.append([name, *(f"{float(e.median()):.2f} / {float(e.mean()):.2f}" for e in errors.values())])
        failures += [f"{name}: {noise}, mean {e.mean():.2f} px" for noise, e in errors.items() if e.mean() > 0.5]
    columns = [list(column) for column in zip(*rows, strict=True)]
    print(f"\nPans of the whole image: median / mean end-point error, px\n{aligned(columns)}")
    return failures


def rejection(cases: list[Case]) -> list[str]:
    """Print how well the patch error works; return the cases in which it is another's, or rejects true vectors."""
    rows = [["", "ε ~ patch error of clean images", "true vectors rejected, %", "zero motion, %"]]
    failures = []
    for case in cases:
        found = trust(case)
        rows.append([case.name, *(f"{value:.2f}" for value in found)])
        if (own := own_error(case)) <= 0.8:
            failures.append(f"{case.name}: ε correlates with the patch error of the returned motion by {own:.2f}")
        if found[1] >= 2:
            failures.append(f"{case.name}: true vectors are rejected on {found[1]:.1f} % of the pixels")
    columns = [list(column) for column in zip(*rows, strict=True)]
    print(f"\nPatch error and rejection (κ 2, η 1.6), correlations and shares\n{aligned(columns)}")
    return failures


def levels(cases: list[Case]) -> None:
    """Print what the level of the patch error does, in cases of known motion."""
    head = ["", "ε ~ ε₀", "ε₀ rejects true motion, %", "ε rejects zero motion, %", "ε₀ rejects zero motion, %"]
    rows = [head]
    for case in cases:
        values = by_level(case)
        rows.append([case.name, f"{values[0]:.2f}", *(f"{value:.1f}" for value in values[1:])])
    columns = [list(column) for column in zip(*rows, strict=True)]
    print(f"\nε of the search's level and ε₀ of single pixels\n{aligned(columns)}")


def masks(folders: list[Path]) -> None:
    """Print the PSNR of accumulation by motion and mask."""
    rows: dict[str, dict[str, float]] = {}
    for folder in folders:
        for motion in ("estimate", "geometric", "zero"):
            name = f"{folder.name}, {motion}"
            rows[name] = {mask: accumulation(folder, motion, *values) for mask, values in MASKS.items()}
    table = [["", *rows], *([mask, *(f"{row[mask]:.2f}" for row in rows.values())] for mask in MASKS)]
    print(f"\nPSNR of align_accumulate, dB, by its mask ({folders[0].parent.name} clips)\n{aligned(table)}")


def main(arguments: Sequence[str]) -> int:
    """Run everything that is asked for; return 1 if something does not hold."""
    parser = make_parser(__doc__)
    parser.add_argument("--recipe", type=Path, default=Path("datasets/correspondence_reduced.yaml"))
    parser.add_argument("--data", type=Path, help="folder of the clips (default: data/ and the recipe's name)")
    parser.add_argument("--fast", action="store_true", help="without Dual TV-L1 and eFOLKI, which take minutes")
    parser.add_argument("--times", action="store_true", help="time and memory too, on a machine that does nothing else")
    parser.add_argument("--json", type=Path, help="write times there")
    given = parser.parse_args(arguments)
    warnings.simplefilter("ignore", FewerLevelsWarning)
    data = given.data or Path("data") / given.recipe.stem
    render_recipe(given.recipe, data)
    split = {name: find_clips([data / name]) for name in ("train", "test")}
    print(f"{given.recipe}: {len(split['train'])} train and {len(split['test'])} test clips, {torch.__version__}")
    print("Settings, chosen on the train clips, discs with 2 and 10 % noise, and waves without noise:")
    train = [case for folder in split["train"] for case in from_clip(folder)]
    chosen = tune([*train, *(case for case in constructed(seed=1) if "pan" not in case.name)], not given.fast)
    test = [case for folder in split["test"] for case in from_clip(folder)]
    made = constructed(seed=2)
    failures = compare([*test, *made], chosen)
    rendered = [(case.name.split(",")[0], case.pairs[0]) for case in test if ", 1 spp" in case.name]
    crops = [(f"{name} {pan}", pair.panned(pan)) for name, pair in rendered for pan in PANS]
    failures += pans([(c.name, c.pairs[0]) for c in made if "pan" in c.name] + crops)
    trusted = [case for case in [*test, *made] if ", 1 spp" in case.name or "disc" in case.name]
    failures += rejection(trusted)
    levels([case for case in trusted if case.pairs[0].truth is not None])
    for folders in map(long_clips, split.values()):
        if folders:
            masks(folders)
    measured: dict[str, Any] = {}
    if given.times:
        measured = costs()
        print(f"\n{cost_table(measured)}\n\n{pass_table(passes())}")
        failures += too_slow(measured)
    for line in failures:
        print(f"does not hold: {line}")
    if given.json:
        given.json.write_text(json.dumps(measured, indent=1))
    return int(bool(failures))


def too_slow(rows: dict[str, dict[str, float]]) -> list[str]:
    """Return the promises about time and memory that do not hold."""
    base = rows["Farnebäck"]["ms"]
    limits = {"ours, half": (1.0, 60), "ours, full": (1.7, 120)}
    slow = [
        f"{name} takes {rows[name]['ms'] / base:.2f} times Farnebäck's time"
        for name, (times, _) in limits.items()
        if rows[name]["ms"] > times * base
    ]
    large = [
        f"{name} takes {rows[name]['peak_mb']:.0f} MB"
        for name, (_, most) in limits.items()
        if rows[name].get("peak_mb", 0.0) >= most
    ]
    return slow + large


if __name__ == "__main__":
    run(main)
