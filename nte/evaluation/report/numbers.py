"""The numbers of an evaluation as the viewer reads them: tables with intervals over clips, curves, and their scale."""

from collections.abc import Iterable

from nte.evaluation.bootstrap import bootstrap_interval
from nte.evaluation.metric_table import METRICS, Row, best_of
from nte.evaluation.metrics import REGIONS
from nte.evaluation.results import means_of

CURVES = ("psnr", "ssim", "flip", "l1", "temporal_l1")
_NOT_OF_REGIONS = ("ms_per_frame",)


def metric_table() -> list[Row]:
    """Describe every metric for the viewer."""
    return [
        {"name": m.name, "label": m.label, "better": m.better, "digits": m.digits, "curve": m.name in CURVES}
        for m in METRICS
    ]


def tables(rows: list[Row]) -> list[Row]:
    """Average over clips, for each region and light that has rows: denoiser → metric → [mean, low, high].

    low and high are the interval of 95 % over clips; null for a single clip. The lights of a report with one are "".
    The first table is that of metrics.json: the whole image, each denoiser scored for its own light.
    """
    lights = list(dict.fromkeys(row["target"] for row in rows))
    there = {(row["region"], row["target"]) for row in rows if row["frames"]}
    several = len(lights) > 1
    parts = [(region, light) for region in REGIONS for light in lights if (region, light) in there]
    parts = [part for part in parts if several or part[0] != "all"]  # with a single light that is the first table
    return [_table(rows, region, light, several) for region, light in [("all", None), *parts]]


def _table(rows: list[Row], region: str, light: str | None, named: bool) -> Row:
    means = means_of(rows, region, light)
    metrics = [m for m in METRICS if region == "all" or m.name not in _NOT_OF_REGIONS]
    best = {metric.name: sorted(best_of(means, metric)) for metric in metrics}
    cells = {
        spec: {m.name: [mean[m.name], *_interval(rows, spec, region, light, m.name)] for m in metrics}
        for spec, mean in means.items()
    }
    return {"region": region, "light": (light or "own") if named else "", "rows": cells, "best": best}


def _interval(
    rows: list[Row], spec: str, region: str, light: str | None, metric: str
) -> tuple[float | None, float | None]:
    own = next((row["target"] for row in rows if row["denoiser"] == spec), None)
    values = _numbers(
        row[metric]
        for row in rows
        if row["denoiser"] == spec and row["region"] == region and row["target"] == (light or own)
    )
    return bootstrap_interval(values) if len(values) > 1 else (None, None)


def _numbers(values: Iterable[float | None]) -> list[float]:
    return [value for value in values if value is not None]
