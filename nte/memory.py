"""The memory of this process, as the operating system counts it."""

import resource
import sys

MB = 1e6  # bytes


def peak_resident_mb() -> float:
    """Return the peak of resident memory since the process began, in MB (10⁶ bytes)."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return (peak if sys.platform == "darwin" else peak * 1024) / MB  # macOS counts bytes, others units of 2¹⁰
