"""The percentile bootstrap: the uncertainty of a mean over few clips."""

import numpy as np
import numpy.typing as npt

RESAMPLES = 10_000


def bootstrap_interval(values: npt.ArrayLike, level: float = 0.95) -> tuple[float, float]:
    """Compute the percentile bootstrap interval (low, high) of the mean of `values` (N,).

    Resamples 10 000 times with a fixed seed. level: the share of resampled means inside the interval. For paired
    differences this is a paired bootstrap: each clip keeps both of its sides.
    """
    given = np.asarray(values, float)
    chosen = np.random.default_rng(0).integers(len(given), size=(RESAMPLES, len(given)))
    low, high = np.quantile(given[chosen].mean(1), [(1 - level) / 2, (1 + level) / 2])
    return float(low), float(high)
