"""A plot of quality against time: a point for each denoiser at each number of threads."""

from collections.abc import Sequence
from pathlib import Path

from nte.errors import NteError
from nte.evaluation.benchmark.results import Measured
from nte.evaluation.metric_table import METRICS
from nte.files import write_whole

_MARKERS = "osD^v"  # of numbers of threads
_METRICS = {metric.name: metric for metric in METRICS}


def write_plot(path: Path, rows: Sequence[Measured]) -> None:
    """Draw PSNR and FLIP against milliseconds per frame, as SVG; up and to the left is better.

    Rows without a quality are left out. Points of a denoiser are joined, if it ran with several numbers of threads.
    Raises NteError if no row has a quality, and if the file cannot be written.
    """
    import matplotlib as mpl
    from matplotlib.figure import Figure
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    judged = [row for row in rows if row.psnr is not None and row.flip is not None]
    if not judged:
        raise NteError(f"{path}: not drawn: no denoiser's target has a reference in the clip")
    specs = list(dict.fromkeys(row.denoiser for row in judged))
    threads = list(dict.fromkeys(row.threads for row in judged))
    times = [row.ms_per_frame for row in judged]
    ticks = (1, 2, 5) if max(times) < 50 * min(times) else (1,)
    with mpl.rc_context({"svg.hashsalt": "nte", "font.size": 9}):
        figure = Figure(figsize=(9, 4.2), layout="constrained")
        for axis, name in zip(figure.subplots(1, 2), ("psnr", "flip"), strict=True):
            for number, spec in enumerate(specs):
                own = [row for row in judged if row.denoiser == spec]
                colour, values = f"C{number % 10}", [getattr(row, name) for row in own]
                axis.plot([row.ms_per_frame for row in own], values, color=colour, linewidth=1, zorder=1)
                for row, value in zip(own, values, strict=True):
                    marker = _MARKERS[threads.index(row.threads) % len(_MARKERS)]
                    label = spec if row is own[0] else None
                    axis.scatter(row.ms_per_frame, value, marker=marker, color=colour, label=label, zorder=2)
            axis.set_xscale("log")
            axis.xaxis.set_major_locator(LogLocator(subs=ticks))
            axis.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
            axis.xaxis.set_minor_formatter(NullFormatter())
            axis.margins(0.15)
            if _METRICS[name].better == "lower":
                axis.invert_yaxis()
            axis.set(xlabel="ms per frame", ylabel=_METRICS[name].label)
            axis.grid(alpha=0.3)
        row = judged[0]
        said = [f"{count} thread{'s' * (count > 1)} {_SHAPES[i % len(_SHAPES)]}" for i, count in enumerate(threads)]
        figure.suptitle(f"{row.width}x{row.height}, {', '.join(said)}; upper left is better")
        handles, labels = figure.axes[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=4, frameon=False)
        notes = {"Date": None, "Creator": None}
        write_whole(path, lambda temporary: figure.savefig(temporary, format="svg", metadata=notes))


_SHAPES = ("●", "■", "◆", "▲", "▼")  # _MARKERS in text
