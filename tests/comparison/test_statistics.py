import math

import numpy as np
import pytest
from scipy.stats import norm

from tfg_drake.comparison.statistics import RESAMPLES, difference, ratio, spread


def brute_force(statistic, *samples):
    """Efron's BCa interval, resample by resample, from the same random numbers."""
    n = len(samples[0])
    rows = np.random.default_rng(0).integers(0, n, (RESAMPLES, n))
    value = statistic(*samples)
    drawn = np.array([statistic(*(sample[row] for sample in samples)) for row in rows])
    bias = norm.ppf((np.mean(drawn < value) + np.mean(drawn <= value)) / 2.0)
    left = np.array([statistic(*(np.delete(sample, i) for sample in samples)) for i in range(n)])
    skew = left.mean() - left
    acceleration = (skew**3).sum() / (6.0 * (skew**2).sum() ** 1.5)
    levels = []
    for level in (0.025, 0.975):
        z = bias + norm.ppf(level)
        levels.append(norm.cdf(bias + z / (1.0 - acceleration * z)))
    return np.quantile(drawn, levels)


@pytest.fixture
def pairs():
    rng = np.random.default_rng(7)
    first = rng.gamma(3.0, 2.0, 12)
    return first, 0.8 * first + rng.normal(0.0, 0.3, 12)


def test_spread_against_brute_force(pairs):
    sample = pairs[0]
    found = spread(sample)
    assert found.n == 12
    assert found.std == pytest.approx(np.sqrt(((sample - sample.mean()) ** 2).sum() / 11))
    assert found.mean.value == pytest.approx(sample.mean())
    assert (found.mean.low, found.mean.high) == pytest.approx(brute_force(np.mean, sample), rel=0.01)


def test_difference_and_ratio_against_brute_force(pairs):
    first, other = pairs
    found = difference(first, other)
    assert found.value == pytest.approx(np.mean(other) - np.mean(first))
    assert (found.low, found.high) == pytest.approx(brute_force(lambda a, b: np.mean(b - a), first, other), rel=0.02)
    found = ratio(first, other)
    assert found.value == pytest.approx(np.mean(other) / np.mean(first))
    expected = brute_force(lambda a, b: np.mean(b) / np.mean(a), first, other)
    assert (found.low, found.high) == pytest.approx(expected, rel=0.01)
    assert found.low < 0.8 < found.high


def test_pairing_takes_out_what_seeds_have_in_common(pairs):
    first, other = pairs
    paired = difference(first, other)
    shuffled = difference(first, other[::-1].copy())
    assert paired.high - paired.low < 0.5 * (shuffled.high - shuffled.low)


def test_the_same_sample_gives_the_same_interval(pairs):
    assert spread(pairs[0]) == spread(pairs[0])


def test_too_little_to_tell():
    assert spread(np.zeros(0)).n == 0
    assert math.isnan(spread(np.zeros(0)).mean.value)
    one = spread(np.array([2.0]))
    assert one.mean.value == 2.0
    assert math.isnan(one.std)
    assert math.isnan(one.mean.low)
    assert math.isnan(ratio(np.array([0.0, 1.0]), np.array([1.0, 1.0])).value)


def test_runs_that_agree_leave_a_point():
    same = spread(np.full(5, 0.1)).mean
    assert same.low == same.value == same.high
    both = ratio(np.array([1.0, 2.0, 4.0]), np.array([2.0, 4.0, 8.0]))
    assert (both.low, both.value, both.high) == (2.0, 2.0, 2.0)
