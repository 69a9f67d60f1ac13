"""The report: one self-contained index.html with the tables, the plots and the pictures of an evaluation."""

import base64
from collections.abc import Mapping
from pathlib import Path

import jinja2
import numpy as np

from nte.evaluation.metric_table import METRICS, Metric, Row, best_of, settings_of
from nte.evaluation.metrics import GLOSSY, MOVING_PX, REGIONS, SHADOWED
from nte.evaluation.results import Evaluation, means_of
from nte.evaluation.score_clip import Shown
from nte.evaluation.targets import BRIGHTENED
from nte.files import write_whole
from nte.frames.show import heat, png_bytes, quantise
from nte.version import __version__

REGION_METRICS = tuple(metric for metric in METRICS if metric.name not in ("mse", "ms_per_frame"))
PLOTTED = tuple(metric for metric in METRICS if metric.name in ("psnr", "ssim", "flip", "l1", "temporal_l1"))


def write_report(evaluation: Evaluation, out: Path, methods: Mapping[str, str] | None = None) -> Path:
    """Write `out`/index.html, which needs neither network nor server, and return its path.

    methods: title → spec, if the evaluation's denoisers have titles. Raises NteError if the file cannot be written.
    """
    html = render_report(evaluation, methods)
    path = out / "index.html"
    write_whole(path, lambda temporary: temporary.write_text(html, encoding="utf-8") and None)
    return path


def render_report(evaluation: Evaluation, methods: Mapping[str, str] | None = None) -> str:
    """Render the report as HTML text, which contains all data of its script as one JSON blob.

    methods: title → spec, if the evaluation's denoisers have titles.
    """
    metrics = evaluation.metrics
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent),
        autoescape=True,  # names of clips and denoisers come from users
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.policies["json.dumps_kwargs"] = {"sort_keys": False, "ensure_ascii": False}
    whole = [row for row in metrics["rows"] if row["region"] == "all"]
    frames = {row["clip"]: row["frames"] for row in whole}
    return environment.get_template("page.html.jinja").render(
        version=__version__,
        clips=list(frames),
        frames=sum(frames.values()),
        first=min(row["scored_from"] for row in whole),
        targets=sorted({row["target"] for row in whole}),
        methods=methods,
        settings=settings_of(metrics["rows"]),
        metrics=METRICS,
        means=_cells(metrics["means"], METRICS),
        region_metrics=REGION_METRICS,
        parts=_parts(metrics["rows"]),
        brightened=BRIGHTENED,
        moving_px=MOVING_PX,
        shadowed=SHADOWED,
        glossy=GLOSSY,
        scale=_data_uri(png_bytes(quantise(heat(np.linspace(0, 1, 256, dtype=np.float32)[None], "magma")))),
        data={
            "rows": metrics["rows"],
            "means": metrics["means"],
            "plotted": [{"name": m.name, "label": m.label, "digits": m.digits, "better": m.better} for m in PLOTTED],
            "shown": [_pictures(shown) for shown in evaluation.shown],
        },
    )


def _parts(rows: list[Row]) -> list[Row]:
    """Tables for each region of each light; with a single light, the whole image has its table already."""
    targets = list(dict.fromkeys(row["target"] for row in rows))
    several = len(targets) > 1
    there = {(row["region"], row["target"]) for row in rows if row["frames"]}
    return [
        {
            "region": region,
            "target": target if several else "",
            "rows": _cells(means_of(rows, region, target), REGION_METRICS),
        }
        for region in REGIONS[0 if several else 1 :]
        for target in targets
        if (region, target) in there
    ]


def _cells(means: dict[str, dict[str, float | None]], metrics: tuple[Metric, ...]) -> dict[str, list[Row]]:
    """Spec → one cell per metric: its text, and whether it is the best of its column."""
    best = {metric.name: best_of(means, metric) for metric in metrics}
    return {
        spec: [{"text": metric.text(row[metric.name]), "best": spec in best[metric.name]} for metric in metrics]
        for spec, row in means.items()
    }


def _pictures(shown: Shown) -> dict[str, object]:
    return {
        "clip": shown.clip,
        "target": shown.target,
        "frame": shown.frame,
        "disoccluded": shown.disoccluded,
        "images": {name: _data_uri(png_bytes(pixels)) for name, pixels in shown.images.items()},
        "flip": {name: _data_uri(png_bytes(pixels)) for name, pixels in shown.flip.items()},
    }


def _data_uri(png: bytes) -> str:
    return "data:image/png;base64," + base64.b64encode(png).decode("ascii")
