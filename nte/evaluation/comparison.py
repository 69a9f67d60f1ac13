"""A published comparison, reproduced: situations, each with its clips, its light, its pixels and its methods."""

import json
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import groupby
from pathlib import Path
from typing import Any

from omegaconf import MISSING

from nte.config import load_config
from nte.errors import NteError
from nte.evaluation.compare import Evaluation, evaluate, means_of, prepare_folder
from nte.evaluation.metrics import REGIONS
from nte.evaluation.report import write_report
from nte.evaluation.strips import write_strips
from nte.evaluation.table import METRICS, aligned
from nte.files import write_whole

FORMAT = "nte-comparison/1"
LIGHTS = ("color", "visibility", "glossy", "indirect")
Row = dict[str, Any]  # situation, method, denoiser, clips; parts: the means of each light and region


@dataclass
class Situation:
    """What one figure of a paper shows."""

    name: str = MISSING  # also the folder of its report
    clips: list[str] = field(default_factory=list)  # patterns below the rendered recipe: test/fence_*
    light: str = "color"  # the component that the figure is about
    region: str = "all"  # the pixels in question
    methods: dict[str, str] = field(default_factory=dict)  # title → denoiser


@dataclass
class Comparison:
    """Clips of one recipe, and what is compared on which of them."""

    recipe: str = MISSING  # path, from the file that says it
    situations: list[Situation] = field(default_factory=list)


def read_comparison(path: Path) -> Comparison:
    """Read and check a comparison; `recipe` becomes a path that can be opened. Raises NteError naming the key."""
    comparison = load_config(Comparison, path)
    comparison.recipe = str(path.parent / comparison.recipe)
    if not comparison.situations:
        raise NteError(f"{path}: 'situations' is empty: expected at least one")
    for number, situation in enumerate(comparison.situations):
        where = f"{path}: situations[{number}]"
        for key, allowed in (("light", LIGHTS), ("region", REGIONS)):
            if (value := getattr(situation, key)) not in allowed:
                raise NteError(f"{where}.{key} is '{value}': expected one of {', '.join(allowed)}")
        for key in ("clips", "methods"):
            if not getattr(situation, key):
                raise NteError(f"{where}.{key} is empty: expected at least one")
    return comparison


def run_comparison(
    comparison: Comparison,
    data: Path,
    out: Path,
    force: bool = False,
    device: str = "cpu",
    progress: Callable[[int, int, str], None] | None = None,
) -> list[Row]:
    """Evaluate every situation on the rendered recipe in `data`; write a report for each, and `out`/summary.json.

    out/<situation>/ has metrics.json, index.html (tables, plots over time, images) and strips/. Raises NteError
    for a pattern without clips and for an `out` that exists without `force`.
    """
    chosen = {situation.name: _clips(situation, data) for situation in comparison.situations}
    prepare_folder(out, force)
    rows: list[Row] = []
    for situation in comparison.situations:
        folder = out / situation.name
        specs = list(dict.fromkeys(situation.methods.values()))
        found = evaluate(chosen[situation.name], specs, folder, force=force, device=device, progress=progress)
        titled = found.titled({spec: title for title, spec in situation.methods.items()})
        write_report(titled, folder, situation.methods)
        write_strips(titled.shown, folder / "strips")
        rows += _rows(situation, found)
    text = json.dumps({"format": FORMAT, "rows": rows}, indent=1, allow_nan=False) + "\n"
    write_whole(out / "summary.json", lambda temporary: temporary.write_text(text, encoding="utf-8"))
    return rows


def summary_table(rows: list[Row]) -> str:
    """A block for each situation: RMSE and SSIM of each method, of its light and of the composite."""
    blocks = []
    for name, own in groupby(rows, key=lambda row: row["situation"]):
        methods = list(own)
        columns = [[f"{name}, {methods[0]['clips']} clips", *(row["method"] for row in methods)]]
        for number, part in enumerate(methods[0]["parts"]):
            where = f"{part['light']}, {part['region']}"
            for metric in (m for m in METRICS if m.name in ("rmse", "ssim")):
                values = [row["parts"][number][metric.name] for row in methods]
                columns.append([f"{where}: {metric.label}", *map(metric.text, values)])
        blocks.append(aligned(columns))
    return "\n\n".join(blocks)


def _clips(situation: Situation, data: Path) -> list[Path]:
    """The finished clips that the patterns name; `sharp` frames beside blurred ones are not meant."""
    found: list[Path] = []
    for pattern in situation.clips:
        matching = sorted(folder for folder in data.glob(pattern) if (folder / "clip.json").is_file())
        if not matching:
            raise NteError(f"{data}: no finished clip matches '{pattern}' of situation '{situation.name}'")
        found += matching
    return found


def _rows(situation: Situation, found: Evaluation) -> list[Row]:
    rows = found.metrics["rows"]
    clips = len({row["clip"] for row in rows})
    parts = dict.fromkeys([(situation.light, "all"), (situation.light, situation.region), ("color", "all")])
    means = {(light, region): means_of(rows, region, light) for light, region in parts}
    nothing = dict.fromkeys(metric.name for metric in METRICS)  # of a denoiser that does not give this light
    return [
        {
            "situation": situation.name, "method": title, "denoiser": spec, "clips": clips,
            "parts": [
                {"light": light, "region": region, **own.get(spec, nothing)} for (light, region), own in means.items()
            ],
        }
        for title, spec in situation.methods.items()
    ]  # fmt: skip
