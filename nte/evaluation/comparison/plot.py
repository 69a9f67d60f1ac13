"""A figure of a comparison: metrics of every frame of one clip, a curve for each method."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from nte.evaluation.comparison.numbers import Evaluated, Method, Selection
from nte.evaluation.metric_table import METRICS
from nte.files import write_whole

if TYPE_CHECKING:
    from matplotlib.lines import Line2D

_METRICS = {metric.name: metric for metric in METRICS}
_DASHES = ("-", "--", ":")  # after ten colours


def write_plot(
    path: Path, found: Evaluated, methods: Sequence[Method], chosen: Selection, metrics: Sequence[str]
) -> None:
    """Draw the metrics of the clip of a selection over its frames, one below the other, as SVG.

    A curve of a network is the mean over its seeds, in a band from the least to the greatest of them. The same numbers
    give the same bytes. Raises NteError if the file cannot be written.
    """
    import matplotlib as mpl
    from matplotlib.figure import Figure
    from matplotlib.ticker import MaxNLocator

    clip = chosen.clips[0]
    curves_of: dict[str, Line2D] = {}  # title → a curve, for the legend
    with mpl.rc_context({"svg.hashsalt": "nte", "font.size": 9, "text.parse_math": False}):  # $ in a title is a $
        figure = Figure(figsize=(8, 0.8 + 2.2 * len(metrics)), layout="constrained")
        axes = figure.subplots(len(metrics), sharex=True, squeeze=False)[:, 0]
        for axis, name in zip(axes, metrics, strict=True):
            for number, method in enumerate(methods):
                curves = _curves(found, method, clip, name, chosen)
                if not curves.size:
                    continue
                frames = chosen.first + np.arange(curves.shape[1])
                dash = _DASHES[number // 10 % len(_DASHES)]
                drawn = axis.plot(frames, curves.mean(0), dash, color=f"C{number % 10}", linewidth=1)
                curves_of.setdefault(method.title, drawn[0])
                if len(curves) > 1:
                    axis.fill_between(frames, curves.min(0), curves.max(0), color=f"C{number % 10}", alpha=0.2, lw=0)
            way = {"higher": " ↑", "lower": " ↓"}.get(_METRICS[name].better, "")
            axis.set_ylabel(_METRICS[name].label + way)
            axis.grid(alpha=0.3)
        axes[-1].set_xlabel("frame")
        axes[-1].xaxis.set_major_locator(MaxNLocator(integer=True))
        axes[0].set_title(f"{clip}: {chosen.title}")
        numbers = [str(number) for number in range(len(curves_of))]
        legend = figure.legend(curves_of.values(), numbers, loc="outside lower center", ncols=4, frameon=False)
        for text, title in zip(legend.get_texts(), curves_of, strict=True):
            text.set_text(title)  # as a label, one that begins with _ would be left out
        write_whole(path, lambda temporary: figure.savefig(temporary, format="svg", metadata=_NOTHING))


_NOTHING: Mapping[str, str | None] = {"Date": None, "Creator": None}


def _curves(
    found: Evaluated, method: Method, clip: str, metric: str, chosen: Selection
) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    """The values (seeds, frames) of a method; NaN where a frame has no number."""
    series = [found.series(spec, clip, metric, chosen) for spec in method.specs]
    return np.array([values for values in series if values], float, ndmin=2)
