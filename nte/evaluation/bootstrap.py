"""The bootstrap: the uncertainty of a mean over few clips and few trainings.

Every training of a method is evaluated on the same clips. So a score x[s, c] has two causes of chance that cross each
other, the seed s of the training and the clip c, and a difference between two methods varies with both:

    θ = mean over c of (mean over s of x[s, c] − mean over t of y[t, c])

Clips are resampled as in any bootstrap: with replacement, each with the scores of all seeds of both methods, which is
what makes it paired. Alone that gives intervals that are too narrow where clips are few: of four normal numbers a
resampled mean has 3/4 of the variance that it should have, and the quantiles of a normal distribution instead of
Student's; a 95 % interval covers the truth in 81 % of cases, with ten in 91 %. So each resample's deviation d from the
mean over n clips becomes

    d · √(n / χ²),   χ² drawn with n − 1 degrees of freedom,

which gives normal numbers the interval of Student's t, and leaves that of many clips as it is. Seeds are too few to be
resampled at all: each resample moves the mean of a method with S > 1 seeds by

    sd / √S · t,   t from Student's distribution with S − 1 degrees of freedom,

where sd is the standard deviation over seeds of the mean over clips. For one seed nothing can be said, and the interval
is that over clips. One clip says nothing about others, however many the seeds, and has no interval.
tests/evaluation/test_bootstrap.py measures how often intervals cover the truth.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

RESAMPLES = 10_000


class Interval(NamedTuple):
    """A mean, and the interval (low, high) that covers it."""

    mean: float
    low: float
    high: float


def bootstrap_interval(values: npt.ArrayLike, level: float = 0.95) -> tuple[float, float]:
    """Compute the bootstrap interval (low, high) of the mean of `values` (N,), widened where N is small.

    Resamples 10 000 times with a fixed seed. level: the share of resampled means inside the interval. For paired
    differences this is a paired bootstrap: each clip keeps both of its sides.
    """
    given = np.asarray(values, float)
    found = difference_interval(given[None], np.zeros((1, len(given))), level)
    return found.low, found.high


def difference_interval(ours: npt.ArrayLike, theirs: npt.ArrayLike, level: float = 0.95) -> Interval:
    """Compute the mean difference ours − theirs and its interval, over clips and seeds together.

    ours: (S, N), scores of S seeds on N clips. theirs: (T, N), of the same clips. Resamples 10 000 times with a fixed
    seed. level: the share of resampled differences inside the interval. One clip has no interval: low and high are the
    mean.
    """
    sides = np.atleast_2d(np.asarray(ours, float)), np.atleast_2d(np.asarray(theirs, float))
    differences = sides[0].mean(0) - sides[1].mean(0)
    clips, mean = len(differences), float(differences.mean())
    if clips == 1:
        return Interval(mean, mean, mean)
    rng = np.random.default_rng(0)
    chosen = rng.integers(clips, size=(RESAMPLES, clips))
    resampled = differences[chosen].mean(1)
    resampled = mean + (resampled - mean) * np.sqrt(clips / rng.chisquare(clips - 1, RESAMPLES))
    for side in sides:
        seeds = len(side)
        if seeds > 1:
            deviation = side.mean(1).std(ddof=1) / seeds**0.5
            resampled = resampled + deviation * rng.standard_t(seeds - 1, RESAMPLES)
    low, high = np.quantile(resampled, [(1 - level) / 2, (1 + level) / 2])
    return Interval(mean, float(low), float(high))
