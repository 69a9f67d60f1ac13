"""Records of the figures that benchmarks print: one JSON object a line, one file a machine, in benchmarks/results/."""

import json
import os
import platform
import re
import subprocess
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "benchmarks" / "results"


@dataclass(frozen=True)
class Figure:
    """One number of one run. A `+` behind the commit means that files differed from it."""

    name: str  # «benchmark: what was measured»
    value: float
    unit: str
    machine: str  # the host's name, its processor and its number of cores
    commit: str
    date: str  # of the run, UTC, ISO 8601


def record(benchmark: str, figures: Mapping[str, float], unit: str, folder: Path = RESULTS) -> Path:
    """Append the figures of a run to this machine's file in `folder`, and return the file's path.

    benchmark: the script's name, which is put before the name of each figure.
    """
    here, commit, date = machine(), current_commit(), datetime.now(UTC).isoformat(timespec="seconds")
    path = folder / f"{re.sub('[^A-Za-z0-9]+', '-', here).strip('-')}.jsonl"
    folder.mkdir(parents=True, exist_ok=True)
    with path.open("a", encoding="utf-8") as file:
        for name, value in figures.items():
            figure = Figure(f"{benchmark}: {name}", float(value), unit, here, commit, date)
            file.write(json.dumps(asdict(figure), ensure_ascii=False) + "\n")
    return path


def read(folder: Path = RESULTS) -> list[Figure]:
    """Return every figure of every machine, the oldest first."""
    return sorted(_lines(sorted(folder.glob("*.jsonl"))), key=lambda figure: figure.date)


def _lines(files: Iterable[Path]) -> Iterator[Figure]:
    for file in files:
        for line in file.read_text(encoding="utf-8").splitlines():
            yield Figure(**json.loads(line))


def machine() -> str:
    """Return the name of this machine; figures of two machines are never compared."""
    return f"{platform.node()}, {_processor()}, {os.cpu_count()} cores"


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:  # not Linux
        return platform.processor() or platform.machine()
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()


def current_commit() -> str:
    """Return the commit of the working tree, with a `+` if its files have been changed; empty outside a repository."""
    command = ["git", "describe", "--always", "--dirty=+", "--abbrev=12", "--exclude=*"]
    try:
        found = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    except FileNotFoundError:
        return ""
    return found.stdout.strip()
