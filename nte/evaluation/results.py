"""The results of an evaluation: the content of metrics.json, means over its rows, and the frames to show."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TypeVar

from nte.evaluation.metric_table import METRICS, Row
from nte.evaluation.score_clip import Shown, mean
from nte.evaluation.units import ClipScores
from nte.files import write_whole
from nte.viewer.recorder import titled

FORMAT = "nte-metrics/1"
_Image = TypeVar("_Image")


@dataclass(frozen=True)
class Evaluation:
    """The content of metrics.json, one frame of each clip and target as pictures, and what the viewer has of clips."""

    metrics: Row
    shown: list[Shown]
    recorded: list[Row] = field(default_factory=list)  # `Recorder.entry` of each clip

    def write(self, out: Path) -> None:
        """Write `out`/metrics.json. Raises NteError if it cannot be written."""
        text = json.dumps(self.metrics, indent=1, allow_nan=False) + "\n"
        write_whole(out / "metrics.json", lambda temporary: temporary.write_text(text, encoding="utf-8"))

    def titled(self, denoisers: Mapping[str, str]) -> "Evaluation":
        """Return a copy that calls denoisers by their titles. denoisers: title → spec, for all denoisers."""
        titles = {spec: title for title, spec in denoisers.items()}

        def rename(images: Mapping[str, _Image]) -> dict[str, _Image]:
            return {titles.get(name, name): image for name, image in images.items()}

        rows = [{**row, "denoiser": titles[row["denoiser"]]} for row in self.metrics["rows"]]
        metrics = {**self.metrics, "rows": rows, "means": rename(self.metrics["means"])}
        shown = [replace(s, images=rename(s.images), flip=rename(s.flip)) for s in self.shown]
        return Evaluation(metrics, shown, [titled(entry, titles) for entry in self.recorded])


def gathered(clips: Sequence[ClipScores]) -> Evaluation:
    """Put the scores of clips together, in their order."""
    rows = [row for clip in clips for row in clip.rows]
    shown = [one for clip in clips for one in clip.shown]
    recorded = [clip.recorded for clip in clips if clip.recorded]
    return Evaluation({"format": FORMAT, "rows": rows, "means": means_of(rows)}, shown, recorded)


def means_of(rows: Sequence[Row], region: str = "all", target: str | None = None) -> dict[str, dict[str, float | None]]:
    """Average the rows of a region over clips: spec → metric → mean over the clips that have a number, or None.

    target: the light that is scored; None takes each denoiser's own target.
    """
    own: dict[str, str] = {}  # the first row of a denoiser has its own target
    for row in rows:
        own.setdefault(row["denoiser"], row["target"])
    by_spec: dict[str, list[Row]] = {}
    for row in rows:
        if row["region"] == region and row["target"] == (target or own[row["denoiser"]]):
            by_spec.setdefault(row["denoiser"], []).append(row)
    return {spec: {m.name: mean(row[m.name] for row in chosen) for m in METRICS} for spec, chosen in by_spec.items()}
