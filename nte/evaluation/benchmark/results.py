"""The results of a benchmark: a row for each denoiser, size and number of threads, and the speed of the machine."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field

from nte.evaluation.metric_table import Row
from nte.machine import Speed
from nte.text_table import aligned

FORMAT = "nte-bench/2"
REAL_TIME = (720, 1280, 30)  # height, width, frames per second


@dataclass(frozen=True)
class Measured:
    """What was measured of one denoiser at one size on a number of CPU threads. Times are in milliseconds."""

    denoiser: str
    width: int
    height: int
    threads: int
    frames: int  # timed ones
    start_ms: float  # loading the denoiser in a new process, where PyTorch and ONNX Runtime are already there
    first_ms: float  # the first frame of a sequence
    ms_per_frame: float  # the median
    p95: float
    peak_mb: float  # peak of resident memory above that of the process with denoiser and first frame loaded
    macs: Mapping[str, float]  # step → multiply-accumulates per pixel; empty for what is no network
    psnr: float | None = None  # means over the timed frames of a clip
    flip: float | None = None
    steps: Mapping[str, float] = field(default_factory=dict)  # step → milliseconds, if they were asked for

    @property
    def macs_per_pixel(self) -> float:
        """Multiply-accumulates per pixel in all."""
        return sum(self.macs.values())

    def share(self, speed: Speed, step: str | None = None) -> float | None:
        """The share of the float32 peak that the multiply-accumulates of a step, or of the whole frame, reach.

        None where they, or the time, are not known.
        """
        macs = self.macs_per_pixel if step is None else self.macs.get(step, 0.0)
        milliseconds = self.ms_per_frame if step is None else self.steps.get(step, 0.0)
        if not macs or not milliseconds:
            return None
        return macs * self.width * self.height / (milliseconds / 1e3) / speed.float32

    @property
    def too_slow(self) -> float:
        """How many times faster it would have to be for 30 frames per second at 1280×720, if time grows with pixels."""
        height, width, rate = REAL_TIME
        return self.ms_per_frame / 1e3 * rate * (height * width) / (self.height * self.width)

    def share_needed(self, speed: Speed) -> float | None:
        """The share of the float32 peak that its multiply-accumulates need for 30 frames per second at 1280×720."""
        height, width, rate = REAL_TIME
        return self.macs_per_pixel * height * width * rate / speed.float32 if self.macs else None


@dataclass(frozen=True)
class Results:
    """Rows in the order of sizes, threads and denoisers; and the machine's speed for each number of threads."""

    rows: Sequence[Measured]
    machine: Mapping[int, Speed]

    def json(self) -> Row:
        """Return the content of the JSON file, as the page about it describes."""
        return {
            "format": FORMAT,
            "machine": [{"threads": threads, **asdict(speed)} for threads, speed in self.machine.items()],
            "rows": [self._row(row) for row in self.rows],
        }

    def _row(self, row: Measured) -> Row:
        speed = self.machine[row.threads]
        return asdict(row) | {
            "macs_per_pixel": row.macs_per_pixel if row.macs else None,
            "share_of_peak": row.share(speed),
            "step_shares_of_peak": {step: row.share(speed, step) for step in row.steps},
            "too_slow_for_720p30": row.too_slow,
            "share_needed_for_720p30": row.share_needed(speed),
        }

    def text(self) -> str:
        """Lay everything out for a terminal: the table, the steps, the machine, and what real time would need."""
        titles = ["denoiser", "size", "threads", "start", "first", "ms", "p95", "MB", "MACs/px", "of peak"]
        judged = any(row.psnr is not None for row in self.rows)
        cells = [self._cells(row, judged) for row in self.rows]
        columns = zip(titles + ["PSNR", "FLIP"] * judged, *cells, strict=True)
        lines = [aligned([list(column) for column in columns])]
        lines += [line for row in self.rows for line in self._steps(row)]
        lines += [_machine(threads, speed) for threads, speed in self.machine.items()]
        return "\n".join([*lines, *self._real_time()])

    def _cells(self, row: Measured, judged: bool) -> list[str]:
        times = (row.start_ms, row.first_ms, row.ms_per_frame, row.p95)
        macs = f"{row.macs_per_pixel:,.0f}" if row.macs else ""
        share = _percent(row.share(self.machine[row.threads]))
        quality = ["" if row.psnr is None else f"{row.psnr:.2f}", "" if row.flip is None else f"{row.flip:.4f}"]
        return [
            row.denoiser, f"{row.width}x{row.height}", str(row.threads), *(f"{time:.1f}" for time in times),
            f"{row.peak_mb:.0f}", macs, share, *(quality if judged else []),
        ]  # fmt: skip

    def _steps(self, row: Measured) -> list[str]:
        speed = self.machine[row.threads]
        shares = {step: _percent(row.share(speed, step)) for step in row.steps}
        return [
            f"{_named(row)}: {step} {milliseconds:.1f} ms" + (f", {shares[step]} of the peak" if shares[step] else "")
            for step, milliseconds in row.steps.items()
        ]

    def _real_time(self) -> list[str]:
        """A line for each denoiser and number of threads, from the size that is closest to 1280×720."""
        height, width, rate = REAL_TIME
        closest: dict[tuple[str, int], Measured] = {}
        for row in sorted(self.rows, key=lambda row: -abs(row.width * row.height - width * height)):
            closest[row.denoiser, row.threads] = row
        rows = [row for row in self.rows if closest[row.denoiser, row.threads] is row]
        return [f"{_named(row)}: {self._needed(row)} for {width}x{height} at {rate} frames/s" for row in rows]

    def _needed(self, row: Measured) -> str:
        slow = row.too_slow
        said = f"{_short(slow)} times too slow" if slow > 1 else f"fast enough ({_short(1 / slow)} times)"
        share = row.share_needed(self.machine[row.threads])
        return said if share is None else f"{said}, {_percent(share)} of the peak needed"


def _machine(threads: int, speed: Speed) -> str:
    """The speed of the machine in a line."""
    peaks = {"float32": speed.float32, "bfloat16": speed.bfloat16, "int8": speed.int8}
    said = ", ".join(f"{name} {value / 1e9:.3g}" for name, value in peaks.items() if value is not None)
    return f"peak of a convolution, {_threads(threads)}: {said} GMAC/s; memory {speed.memory / 1e9:.3g} GB/s"


def _named(row: Measured) -> str:
    return f"{row.denoiser} {row.width}x{row.height}, {_threads(row.threads)}"


def _threads(count: int) -> str:
    return f"{count} thread" + "s" * (count > 1)


def _percent(share: float | None) -> str:
    return "" if share is None else f"{_short(100 * share)} %"


def _short(number: float) -> str:
    """A number in two digits, or its whole part from 100."""
    return f"{number:.0f}" if number >= 100 else f"{number:.2g}"
