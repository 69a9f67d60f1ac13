"""Time and memory of the methods that find motion, measured in one run on the same cores."""

import multiprocessing
import time
from collections.abc import Callable
from functools import partial
from itertools import zip_longest
from pathlib import Path
from typing import Any

import cv2
import torch
from torch import Tensor

from benchmarks.flows import FLOWS, Find, ours
from nte.motion.agreement import agree
from nte.motion.patch_distance import best_shift
from nte.motion.pyramid import SCALE
from nte.motion.search import SEARCHES
from nte.text_table import aligned

TIMED, MEASURED = (720, 1280), (1024, 1024)  # (height, width) for time, and for memory
COSTED: dict[str, Find] = {
    **FLOWS,
    "ours, full": ours("moderate"),
    "ours, half": ours("moderate", True),
    "ours, clean": ours("clean"),
    "ours for 1 spp": ours("noisy"),
    "ours for 1 spp, full": ours("noisy", False),
}
_STATUS = Path("/proc/self/status")
_SLOW = ("Dual TV-L1", "eFOLKI")  # timed once, on a sixteenth of the pixels, times 16


def costs(repetitions: int = 5) -> dict[str, dict[str, float]]:
    """Measure every method: `ms` at 1280×720, the least of alternating repetitions, and `peak_mb` at 1024×1024.

    OpenCV gets as many threads as PyTorch. Dual TV-L1 and eFOLKI take minutes, so they run once at 320×180, and their
    time is multiplied by 16; their memory is not measured. peak_mb: the growth of a fresh process's peak of resident
    memory; on Linux only.
    """
    cv2.setNumThreads(torch.get_num_threads())
    images, few = _images(TIMED), _images((TIMED[0] // 4, TIMED[1] // 4))
    seconds: dict[str, list[float]] = {name: [] for name in COSTED}
    for repetition in range(repetitions):
        for name, find in COSTED.items():
            if name not in _SLOW:
                seconds[name].append(_seconds(find, *images))
            elif repetition == 0:
                seconds[name].append(16 * _seconds(find, *few))
    found = peaks()
    return {
        name: {"ms": 1000 * min(s), **({"peak_mb": found[name]} if name in found else {})}
        for name, s in seconds.items()
    }


def peaks() -> dict[str, float]:
    """Measure `peak_mb` of every method that does not take minutes, each in a process of its own."""
    names = [name for name in COSTED if name not in _SLOW and _STATUS.exists()]
    with multiprocessing.get_context("spawn").Pool(1, maxtasksperchild=1) as pool:
        return dict(zip(names, pool.map(peak_mb, names, chunksize=1), strict=True))


def passes(repetitions: int = 5) -> dict[str, float]:
    """Measure the milliseconds of each pass of the search for 1 spp at 1280×720, and of the whole search.

    Each number is the least of repetitions in turn.
    """
    search = SEARCHES["noisy"]
    height, width = (size // 2 for size in TIMED)
    tasks: dict[str, Callable[[], Any]] = {}
    for level, (radius, strength) in enumerate(zip_longest(search.radii, search.agreement, fillvalue=0)):
        images = _images((-(-height // SCALE**level), -(-width // SCALE**level)))
        refine = level < search.refined
        tasks[f"level {level}, search"] = partial(best_shift, *images, int(radius), search.norm, refine)
        if strength:
            motion = torch.zeros(1, 2, *images[0].shape[2:])
            tasks[f"level {level}, agreement"] = partial(agree, *images, motion, strength)
    tasks["all, with pyramid and warps"] = partial(ours("noisy"), *_images(TIMED))
    seconds: dict[str, list[float]] = {name: [] for name in tasks}
    for _ in range(1 + repetitions):
        for name, task in tasks.items():
            seconds[name].append(_seconds(task))
    return {name: 1000 * min(times[1:]) for name, times in seconds.items()}


def peak_mb(name: str) -> float:
    """Return the growth of this process's peak of resident memory, MB, in a call at 1024×1024, after a small call."""
    COSTED[name](*_images((128, 128)))
    images = _images(MEASURED)
    Path("/proc/self/clear_refs").write_text("5")  # forget the peak of the imports and of the process before exec
    before = _resident("VmRSS")
    COSTED[name](*images)
    return _resident("VmHWM") - before


def cost_table(rows: dict[str, dict[str, float]]) -> str:
    """Format the costs as a table, with times also as multiples of Farnebäck's."""
    base = rows["Farnebäck"]["ms"]
    return aligned(
        [
            ["method", *rows],
            ["ms at 1280x720", *(f"{row['ms']:.0f}" for row in rows.values())],
            ["x Farnebäck", *(f"{row['ms'] / base:.2f}" for row in rows.values())],
            ["MB at 1024x1024", *(f"{row['peak_mb']:.0f}" if "peak_mb" in row else "–" for row in rows.values())],
        ]
    )


def pass_table(rows: dict[str, float]) -> str:
    """Format the passes as a table, one pass of the search per line."""
    return aligned([["pass", *rows], ["ms", *(f"{ms:.1f}" for ms in rows.values())]])


def _images(size: tuple[int, int]) -> tuple[Tensor, Tensor]:
    """A smooth texture that has moved by (3, 1) px, with 2 % noise."""
    generator = torch.Generator().manual_seed(0)
    height, width = size
    coarse = torch.rand(1, 1, height // 8 + 3, width // 8 + 3, generator=generator)
    large = torch.nn.functional.interpolate(coarse, scale_factor=8, mode="bicubic")
    cut = large[..., 4 : 4 + height, 4 : 4 + width], large[..., 5 : 5 + height, 7 : 7 + width]
    current, previous = ((i + 0.02 * torch.randn(i.shape, generator=generator)).clamp(0, 1) for i in cut)
    return current, previous


def _seconds(call: Callable[..., Any], *arguments: Any) -> float:
    start = time.perf_counter()
    call(*arguments)
    return time.perf_counter() - start


def _resident(key: str) -> float:
    """Megabytes of resident memory now (VmRSS), or at its peak (VmHWM)."""
    line = next(line for line in _STATUS.read_text().splitlines() if line.startswith(key))
    return int(line.split()[1]) * 1024 / 1e6
