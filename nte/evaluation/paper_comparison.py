"""The reproduction of a published comparison: situations, each with its clips, light, pixels and methods."""

import json
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, field
from itertools import groupby
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from omegaconf import MISSING

from nte.config import load_config
from nte.errors import NteError
from nte.evaluation.bootstrap import bootstrap_interval
from nte.evaluation.evaluate import Advance, evaluate, prepare_folder
from nte.evaluation.metric_table import METRICS
from nte.evaluation.metrics import REGIONS
from nte.evaluation.report.strips import write_strips
from nte.evaluation.results import Evaluation, means_of
from nte.files import is_folder_name, only_writer, refuse_links, write_whole
from nte.frames.channels import TARGETS
from nte.interrupt import end_when_told, ending_workers
from nte.text_table import aligned

FORMAT = "nte-comparison/1"
MARGIN = "rmse"  # the metric whose difference from `against` gets an interval
Row = dict[str, Any]  # situation, method, denoiser, clips, margin; parts: the means of each light and region


@dataclass
class Situation:
    """One figure of a paper: clips, light and pixels, and the methods that it compares."""

    name: str = MISSING  # also the folder of its report
    clips: list[str] = field(default_factory=list)  # patterns below the rendered recipe, such as test/fence_*
    light: str = "color"  # the component that the figure is about
    region: str = "all"  # the pixels that the figure is about
    methods: dict[str, str] = field(default_factory=dict)  # title → denoiser
    first: int | None = None  # index of the first frame that is scored; None takes that of the comparison


@dataclass
class Comparison:
    """A comparison on the clips of one recipe, as read from YAML."""

    recipe: str = MISSING  # path, relative to the comparison's file
    first: int = 1  # index of the first frame that is scored; before it, histories are still short
    against: str = ""  # title of the method that all others are compared with, clip by clip
    situations: list[Situation] = field(default_factory=list)


def read_comparison(path: Path) -> Comparison:
    """Read and check a comparison; `recipe` becomes a path that can be opened.

    Raises NteError, naming the file and the key, for a comparison that is not valid.
    """
    comparison = load_config(Comparison, path)
    comparison.recipe = str(path.parent / comparison.recipe)
    if not comparison.situations:
        raise NteError(f"{path}: 'situations' is empty: expected at least one")
    for number, situation in enumerate(comparison.situations):
        where = f"{path}: situations[{number}]"
        situation.first = comparison.first if situation.first is None else situation.first
        if situation.first < 0:
            raise NteError(f"{where}.first is {situation.first}: expected the index of a frame, 0 or more")
        for key, allowed in (("light", TARGETS), ("region", REGIONS)):
            if (value := getattr(situation, key)) not in allowed:
                raise NteError(f"{where}.{key} is '{value}': expected one of {', '.join(allowed)}")
        if not is_folder_name(situation.name):
            raise NteError(f"{where}.name is {situation.name!r:.60}: expected the name of a folder")
        for key in ("clips", "methods"):
            if not getattr(situation, key):
                raise NteError(f"{where}.{key} is empty: expected at least one")
        if comparison.against and comparison.against not in situation.methods:
            known = ", ".join(situation.methods)
            raise NteError(f"{where}.methods lacks '{comparison.against}', named by 'against'; it has {known}")
    names = [situation.name for situation in comparison.situations]
    if twice := [name for name in names if names.count(name) > 1]:
        raise NteError(f"{path}: two situations are called '{twice[0]}': expected a name of its own for each")
    return comparison


def run_comparison(
    comparison: Comparison,
    data: Path,
    out: Path,
    force: bool = False,
    device: str = "cpu",
    progress: Advance | None = None,
    jobs: int = 1,
) -> list[Row]:
    """Evaluate every situation on the rendered recipe in `data`; write a report for each, and `out`/summary.json.

    out/<situation>/ gets metrics.json, index.html (tables, plots over time, images) and strips/. jobs: number of
    situations that are evaluated at the same time, each in its own process. progress: called with frames done, frames
    in all and the frame's name; with several jobs it counts situations. Returns the rows of the summary. Raises
    NteError for a pattern without clips and for an `out` that exists without `force`.
    """
    units = [
        _Unit(situation, _clips(situation, data), out / situation.name, comparison.against, force, device)
        for situation in comparison.situations
    ]
    prepare_folder(out, force)
    refuse_links(out)
    with only_writer(out):
        by_name = dict(_in_processes(units, jobs, progress) if jobs > 1 else ((u.name, u.run(progress)) for u in units))
        rows = [row for unit in units for row in by_name[unit.name]]
        text = json.dumps({"format": FORMAT, "rows": rows}, indent=1, allow_nan=False) + "\n"
        write_whole(out / "summary.json", lambda temporary: temporary.write_text(text, encoding="utf-8"))
    return rows


@dataclass(frozen=True)
class _Unit:
    """The work of one process: a situation and all that its evaluation depends on."""

    situation: Situation
    clips: list[Path]
    folder: Path
    against: str
    force: bool
    device: str

    @property
    def name(self) -> str:
        return self.situation.name

    def run(self, progress: Advance | None = None) -> list[Row]:
        """Evaluate, write the report and the strips, and return the rows of the summary."""
        methods, first = self.situation.methods, self.situation.first
        assert first is not None
        found = evaluate(
            self.clips, list(dict.fromkeys(methods.values())), self.folder, first, [self.situation.light],
            self.force, self.device, progress, methods,
        )  # fmt: skip
        write_strips(found.titled(methods).shown, self.folder / "strips")
        return _rows(self.situation, found, self.against)


def _in_processes(units: list[_Unit], jobs: int, progress: Advance | None) -> Iterator[tuple[str, list[Row]]]:
    """Run units in processes; yield (name, rows) as they end. Spawned, as a fork copies PyTorch's threads' locks."""
    pool = ProcessPoolExecutor(jobs, mp_context=get_context("spawn"), initializer=_begin_worker)
    try:
        with ending_workers():
            futures = {pool.submit(unit.run): unit for unit in units}
            for done, future in enumerate(as_completed(futures), 1):
                yield futures[future].name, future.result()
                if progress:
                    progress(done, len(units), futures[future].name)
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _begin_worker() -> None:
    """Leave the cores to the other processes, and end when told."""
    import torch

    end_when_told()
    torch.set_num_threads(1)


def summary_table(rows: list[Row]) -> str:
    """Format the rows as text: for each situation, RMSE and SSIM of each method in its light and the composite.

    The last column is the margin: the method's RMSE minus that of the method that it is compared with, in the
    situation's pixels, as the mean over the clips and the 95 % interval of a paired bootstrap over clips.
    """
    blocks = []
    for name, own in groupby(rows, key=lambda row: row["situation"]):
        methods = list(own)
        columns = [[f"{name}, {methods[0]['clips']} clips", *(row["method"] for row in methods)]]
        for number, part in enumerate(methods[0]["parts"]):
            where = f"{part['light']}, {part['region']}"
            for metric in (m for m in METRICS if m.name in ("rmse", "ssim")):
                values = [row["parts"][number][metric.name] for row in methods]
                columns.append([f"{where}: {metric.label}", *map(metric.text, values)])
        if against := next((row["margin"]["against"] for row in methods if row["margin"]), ""):
            columns.append([f"RMSE − {against}'s, 95 % interval", *(_margin_text(row["margin"]) for row in methods)])
        blocks.append(aligned(columns))
    return "\n\n".join(blocks)


def _clips(situation: Situation, data: Path) -> list[Path]:
    """The finished clips, folders with clip.json, that a situation's patterns name; raises NteError if one has none.

    Sharp twins of blurred clips lie below sharp/, where patterns such as test/fence_* do not reach.
    """
    found: list[Path] = []
    for pattern in situation.clips:
        try:
            if ".." in Path(pattern).parts:
                raise ValueError("it leads out of it")
            matching = sorted(folder for folder in data.glob(pattern) if (folder / "clip.json").is_file())
        except (ValueError, NotImplementedError, IndexError) as error:  # empty, absolute, «.», a ** within a word
            where = f"'{pattern}' of situation '{situation.name}'"
            raise NteError(f"{where} is no pattern below {data}: {error}") from error
        if not matching:
            raise NteError(f"{data}: no finished clip matches '{pattern}' of situation '{situation.name}'")
        found += matching
    return found


def _margin_text(margin: Row | None) -> str:
    return "–" if margin is None else "{mean:+.4f} ({low:+.4f} … {high:+.4f})".format(**margin)


def _margin(rows: list[Row], situation: Situation, spec: str, against: str) -> Row | None:
    """The mean difference in error between `spec` and the method titled `against`, clip by clip, with its interval.

    None for `against` itself, and if no clip has both errors.
    """
    if not against or spec == situation.methods[against]:
        return None

    def of(denoiser: str) -> dict[str, float]:
        return {
            row["clip"]: row[MARGIN]
            for row in rows
            if (row["denoiser"], row["target"], row["region"]) == (denoiser, situation.light, situation.region)
            and row[MARGIN] is not None
        }

    ours, theirs = of(spec), of(situation.methods[against])
    differences = [ours[clip] - theirs[clip] for clip in ours if clip in theirs]
    if not differences:
        return None
    low, high = bootstrap_interval(differences)
    mean = sum(differences) / len(differences)
    return {"against": against, "metric": MARGIN, "clips": len(differences), "mean": mean, "low": low, "high": high}


def _rows(situation: Situation, found: Evaluation, against: str) -> list[Row]:
    rows = found.metrics["rows"]
    clips = len({row["clip"] for row in rows})
    parts = dict.fromkeys([(situation.light, "all"), (situation.light, situation.region), ("color", "all")])
    means = {(light, region): means_of(rows, region, light) for light, region in parts}
    nothing = dict.fromkeys(metric.name for metric in METRICS)  # for a denoiser that does not give this light
    return [
        {
            "situation": situation.name,
            "method": title,
            "denoiser": spec,
            "clips": clips,
            "margin": _margin(rows, situation, spec, against),
            "parts": [
                {"light": light, "region": region, **own.get(spec, nothing)} for (light, region), own in means.items()
            ],
        }
        for title, spec in situation.methods.items()
    ]
