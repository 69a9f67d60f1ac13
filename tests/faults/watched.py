"""Processes that run a command while a test watches what it does to files."""

import multiprocessing
import os
import sys
from collections.abc import Callable, Sequence

from nte.cli import main
from nte.runtime import trial

# Forks processes that have imported what the commands need, and have started no thread yet.
WARM = multiprocessing.get_context("forkserver")
WARM.set_forkserver_preload(
    [f"nte.{name}" for name in ("evaluation.evaluate", "estimation", "filters.taa", "runtime.export", "sequences")]
    + ["nte.training.run", "onnxscript", "flip_evaluator", "PIL.Image", "matplotlib.pyplot", __name__]
)


def watched(arguments: Sequence[str], audit: Callable[[str, tuple[object, ...]], None]) -> int:
    """Run a command in silence and return its exit code; audit(event, details) is called as sys.addaudithook says.

    Only for a process of its own, since a hook stays.
    """
    trial.CHECK_FRAMES = 2  # the check takes long, and changes no file
    with open(os.devnull, "w") as nowhere:
        sys.stdout = sys.stderr = nowhere
        sys.addaudithook(audit)
        return main(arguments)
