"""The table of metrics: the name of each number, which way is better, how it is computed; and means as text."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

from nte.text_table import aligned

Row: TypeAlias = dict[str, Any]  # the content of metrics.json, or one of its rows, by its keys


@dataclass(frozen=True)
class Metric:
    """One row of the table: a number of metrics.json, and how to read it."""

    name: str
    label: str
    better: Literal["higher", "lower", ""]  # "" if there is no best, as for a property of the clip
    digits: int
    how: str

    def text(self, value: float | None) -> str:
        """Format the number for a table; None becomes –."""
        return "–" if value is None else f"{value:.{self.digits}f}"


METRICS = (
    Metric("psnr", "PSNR, dB", "higher", 2, "10·log₁₀(1/MSE), peak 1, limited to 100 dB."),
    Metric("ssim", "SSIM", "higher", 4, "Structural similarity, Gaussian window 11×11 with σ 1.5 (torchmetrics)."),
    Metric("flip", "FLIP", "lower", 4, "NVIDIA's LDR-FLIP at 67 pixels per degree: the difference an eye would see."),
    Metric("l1", "L1", "lower", 4, "Mean |output − reference|."),
    Metric("mse", "MSE", "lower", 5, "Mean (output − reference)²."),
    Metric("rmse", "RMSE", "lower", 4, "Root of the frame's MSE."),
    Metric(
        "temporal_l1", "Temporal L1", "lower", 5,
        "Mean |Δoutput − Δreference|, where Δ is this frame minus the frame before: flicker, lag and boiling. "
        "The first pair includes frame 0.",
    ),
    Metric(
        "temporal_l1_floor", "Temporal floor", "", 5,
        "What a perfect denoiser would get as Temporal L1, because the reference has noise of its own: "
        "½·mean |Δa − Δb| of the reference's two independent halves a and b.",
    ),
    Metric(
        "ms_per_frame", "ms/frame", "", 1,
        "Median wall-clock time of a step on this machine, without the first frame, reading and scoring.",
    ),
)  # fmt: skip


def best_of(means: Mapping[str, Mapping[str, float | None]], metric: Metric) -> set[str]:
    """Find the denoisers that are best in a metric, by its printed digits; none if there is nothing to compare.

    means: denoiser → metric → mean.
    """
    values = {spec: float(metric.text(v)) for spec, row in means.items() if (v := row[metric.name]) is not None}
    if not metric.better or len(values) < 2:
        return set()
    best = max(values.values()) if metric.better == "higher" else min(values.values())
    return {spec for spec, value in values.items() if value == best}


def format_table(metrics: Row) -> str:
    """Format the means over clips as plain text: a line per denoiser, then settings; * marks the best of each column.

    metrics: the content of metrics.json.
    """
    means = metrics["means"]
    columns = [["denoiser", *means]]
    for metric in METRICS:
        best = best_of(means, metric)
        cells = [metric.text(row[metric.name]) + ("*" if spec in best else " ") for spec, row in means.items()]
        columns.append([metric.label + " ", *cells])
    notes = [f"{spec}: {'; '.join(found)}" for spec, found in settings_of(metrics["rows"]).items()]
    return "\n".join([aligned(columns), *notes])


def settings_of(rows: Iterable[Row]) -> dict[str, list[str]]:
    """Collect the settings of denoisers that adapt them to a clip: denoiser → settings, with clips if they differ."""
    clips: dict[str, dict[str, list[str]]] = {}
    for row in rows:
        if "settings" in row:
            clips.setdefault(row["denoiser"], {}).setdefault(row["settings"], []).append(row["clip"])
    return {
        spec: [
            setting if len(found) == 1 else f"{setting} on {', '.join(dict.fromkeys(names))}"
            for setting, names in found.items()
        ]
        for spec, found in clips.items()
    }
