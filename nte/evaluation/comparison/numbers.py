"""The numbers of a table: means over clips and seeds of a selection, and margins with intervals.

What was evaluated is given by rows of metrics.json. As these have the values of each frame, a table may begin at any
frame that was scored.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from nte.evaluation.bootstrap import difference_interval
from nte.evaluation.metric_table import Row
from nte.evaluation.score_clip import mean

Scores = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Method:
    """A line of a table: a denoiser, or the seeds of a network that were trained."""

    title: str
    specs: tuple[str, ...]  # as in rows; none if every seed has failed
    seeds: tuple[int, ...] = ()  # those of a network, in the order of specs


@dataclass(frozen=True)
class Selection:
    """The part of an evaluation that a part of a table is about."""

    title: str
    clips: tuple[str, ...]  # labels
    light: str
    region: str
    first: int  # index of the first frame that counts


class Evaluated:
    """The rows of an evaluation, found by denoiser, clip, light and region."""

    def __init__(self, rows: Iterable[Row]) -> None:
        self._rows = {(row["denoiser"], row["clip"], row["target"], row["region"]): row for row in rows}

    def value(self, spec: str, clip: str, metric: str, chosen: Selection) -> float | None:
        """Average a metric over the frames of a clip from `chosen.first` on; None if there is no number."""
        row = self._rows.get((spec, clip, chosen.light, chosen.region))
        if row is None:
            return None
        return row[metric] if metric not in row["per_frame"] else mean(frames_of(row, metric, chosen.first))

    def scores(self, method: Method, metric: str, chosen: Selection) -> Scores:
        """Return the scores (seeds, clips) of a method; NaN where there is no number."""
        values = [[self.value(spec, clip, metric, chosen) for clip in chosen.clips] for spec in method.specs]
        return np.array(values, float).reshape(len(method.specs), len(chosen.clips))

    def series(self, spec: str, clip: str, metric: str, chosen: Selection) -> list[float | None]:
        """Return the values of a metric in each frame of a clip from `chosen.first` on."""
        row = self._rows.get((spec, clip, chosen.light, chosen.region))
        return [] if row is None else frames_of(row, metric, chosen.first)


def frames_of(row: Row, metric: str, first: int) -> list[float | None]:
    """Return the values of a row's frames from index `first` on."""
    values: list[float | None] = row["per_frame"][metric]
    return values[max(0, first - row["scored_from"]) :]


def part_of(
    found: Evaluated,
    method: Method,
    chosen: Selection,
    metrics: Sequence[str],
    margins: Sequence[str],
    against: Method | None,
) -> Row:
    """Make the numbers of one line in one part of a table, as they stand in summary.json.

    metrics: name → mean over clips and seeds, None if there is no number. counted: name → number of clips with one,
    out of `clips`. seeds: name → the means of each seed.
    margins: name → mean difference from `against`, interval, number of clips, and of seeds of both.
    """
    scores = {name: found.scores(method, name, chosen) for name in dict.fromkeys([*metrics, *margins])}
    part: Row = {
        "light": chosen.light, "region": chosen.region, "first": chosen.first, "clips": len(chosen.clips),
        "metrics": {name: _mean(scores[name]) for name in metrics},
        "counted": {name: _known(scores[name]).shape[1] if len(scores[name]) else 0 for name in metrics},
    }  # fmt: skip
    if method.seeds:
        part["seeds"] = {name: [_mean(values[None]) for values in scores[name]] for name in metrics}
    if against and against.title != method.title:
        part["margins"] = {
            name: _margin(scores[name], found.scores(against, name, chosen), against.title) for name in margins
        }
    return part


def _mean(scores: Scores) -> float | None:
    """The mean over clips and seeds, of the clips that count."""
    known = _known(scores)
    return float(known.mean()) if known.size else None


def _known(scores: Scores) -> Scores:
    """The scores without clips that lack a number, such as those without a pixel of the region."""
    return scores[:, np.isfinite(scores).all(0)]


def _margin(ours: Scores, theirs: Scores, against: str) -> Row | None:
    both = np.isfinite(ours).all(0) & np.isfinite(theirs).all(0)
    if not (len(ours) and len(theirs) and both.any()):
        return None
    found = difference_interval(ours[:, both], theirs[:, both])
    return {"against": against, "clips": int(both.sum()), "seeds": [len(ours), len(theirs)], **found._asdict()}
