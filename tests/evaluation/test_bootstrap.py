"""Intervals of mean differences: known answers, and how often they cover the truth of synthetic scores."""

import numpy as np
import pytest

from nte.evaluation.bootstrap import bootstrap_interval, difference_interval

REPEATS = 1000


def covered(seeds: tuple[int, int], clips: int, seed_sd: float, clip_sd: float, noise_sd: float) -> float:
    """The share of intervals that contain the true difference, 0, of scores with three causes of chance.

    Each training has an effect of its own on all clips (seed_sd; a method with one seed is no training), each clip one
    on the difference of the two methods (clip_sd), and each training on each clip one more (noise_sd).
    """
    rng = np.random.default_rng(7)
    hits = 0
    for _ in range(REPEATS):
        common = rng.normal(30, 5, clips)  # which pairs remove
        sides = [common + rng.normal(0, seed_sd * (n > 1), (n, 1)) + rng.normal(0, noise_sd, (n, clips)) for n in seeds]
        sides[0] = sides[0] + rng.normal(0, clip_sd, clips)
        found = difference_interval(*sides)
        hits += found.low <= 0 <= found.high
    return hits / REPEATS


@pytest.fixture(autouse=True)
def fewer_resamples(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("nte.evaluation.bootstrap.RESAMPLES", 1000)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seeds", "sds"),
    [
        ((1, 1), (0.0, 1.0, 0.2)),  # analytic filters: clips alone
        ((3, 1), (1.0, 0.0, 0.1)),  # one network, whose trainings differ and nothing else
        ((3, 3), (1.0, 0.0, 0.1)),  # two networks: two distributions with heavy tails, and so too wide rather than not
        ((3, 3), (0.5, 1.0, 0.5)),
        ((3, 3), (0.05, 1.0, 0.2)),
        ((3, 1), (0.3, 1.0, 0.3)),
        ((5, 3), (1.0, 0.5, 0.5)),
    ],
)
def test_the_interval_covers_the_truth_as_often_as_it_says(
    seeds: tuple[int, int], sds: tuple[float, float, float]
) -> None:
    assert 0.92 <= covered(seeds, 40, *sds) <= 0.995


@pytest.mark.slow
@pytest.mark.parametrize("seeds", [(1, 1), (3, 3)])
@pytest.mark.parametrize("clips", [4, 10])
def test_so_it_does_with_few_clips(clips: int, seeds: tuple[int, int]) -> None:
    assert 0.92 <= covered(seeds, clips, 0.3, 1.0, 0.3) <= 0.995


@pytest.mark.parametrize(("count", "least", "most"), [(3, 0.7, 0.8), (4, 0.77, 0.85), (10, 0.88, 0.93)])
def test_resampling_alone_would_cover_less(count: int, least: float, most: float) -> None:
    """Why there is a factor for clips, and seeds are not resampled: the ground that the module's text gives."""
    rng = np.random.default_rng(7)
    hits = 0
    for _ in range(REPEATS):
        values = rng.normal(0, 1, count)
        means = values[rng.integers(count, size=(1000, count))].mean(1)
        low, high = np.quantile(means, [0.025, 0.975])
        hits += low <= 0 <= high
    assert least < hits / REPEATS < most


def test_pairs_remove_what_clips_have_in_common() -> None:
    rng = np.random.default_rng(1)
    common = rng.normal(30, 10, 20)
    found = difference_interval([common + 1, common + 1.5], [common])
    assert found.mean == pytest.approx(1.25)
    alone = difference_interval(common[None] + 1, common[None])
    assert (alone.low, alone.mean, alone.high) == pytest.approx((1, 1, 1))


def test_one_seed_is_the_bootstrap_over_clips_and_sides_swap() -> None:
    rng = np.random.default_rng(2)
    ours, theirs = rng.normal(0, 1, (2, 1, 30))
    found = difference_interval(ours, theirs)
    assert (found.low, found.high) == bootstrap_interval((ours - theirs)[0])
    swapped = difference_interval(theirs, ours)
    assert (swapped.low, swapped.high) == pytest.approx((-found.high, -found.low), abs=0.02)
    assert difference_interval(ours, theirs) == found  # the same numbers each time


def test_one_clip_has_no_interval_however_many_seeds() -> None:
    found = difference_interval([[3.0], [1.0], [2.0]], [[0.5]])
    assert found == (1.5, 1.5, 1.5)


def test_few_seeds_that_differ_widen_the_interval() -> None:
    ours = np.zeros((3, 50)) + np.array([[-1], [0], [1]])
    found = difference_interval(ours, np.zeros((1, 50)))
    assert found.high == pytest.approx(4.303 / 3**0.5, rel=0.25)  # t with 2 degrees of freedom
