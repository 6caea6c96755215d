"""Statistics of a comparison: mean, spread, and intervals of a mean, a paired difference and a ratio.

Intervals are 95 % bootstrap intervals (Efron's BCa), drawn from a fixed seed: the same runs give the same report. They
are nan for fewer than two runs, and a point where all runs agree. A difference and a ratio are paired: both methods met
the same world, start and noise, so the seeds are resampled, not the runs.
"""

from __future__ import annotations

import dataclasses
import math
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.stats import bootstrap

from tfg_drake.messages import FloatArray

RESAMPLES = 5000


@dataclasses.dataclass(frozen=True)
class Interval:
    """A figure and the bounds of its confidence interval."""

    value: float
    low: float
    high: float


@dataclasses.dataclass(frozen=True)
class Spread:
    """Some runs' figure: how many (n), its mean with the interval of that mean, and its standard deviation (of the
    sample, nan for one run)."""

    n: int
    mean: Interval
    std: float


def spread(sample: FloatArray) -> Spread:
    """The spread of a sample (n,), all nan for none."""
    std = float(sample.std(ddof=1)) if len(sample) > 1 else math.nan
    return Spread(len(sample), _interval(np.mean, sample), std)


def difference(first: FloatArray, other: FloatArray) -> Interval:
    """The mean of other - first over pairs (n,)."""
    return _interval(np.mean, other - first)


def ratio(first: FloatArray, other: FloatArray) -> Interval:
    """The mean of other over the mean of first, of pairs (n,); nan unless every first is positive.

    Of the means, not the mean of the ratios: one seed on which the first method happened to be nearly exact would
    outweigh all others.
    """
    if not np.all(first > 0.0):
        return Interval(math.nan, math.nan, math.nan)
    return _interval(_ratio_of_means, first, other)


def _ratio_of_means(first: FloatArray, other: FloatArray, axis: int = -1) -> Any:
    return np.mean(other, axis=axis) / np.mean(first, axis=axis)


def _interval(statistic: Callable[..., Any], *samples: FloatArray) -> Interval:
    """The statistic of one sample, or of samples paired entry by entry, with its interval."""
    n = len(samples[0])
    if n == 0:
        return Interval(math.nan, math.nan, math.nan)
    value = float(statistic(*samples))
    if n == 1:
        return Interval(value, math.nan, math.nan)
    leave_one_out = [statistic(*(np.delete(sample, i) for sample in samples)) for i in range(n)]
    if np.ptp(leave_one_out) <= 1e-12 * abs(value):  # All runs agree: nothing to resample.
        return Interval(value, value, value)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Of a degenerate distribution: the bounds are nan then, and shown as such.
        result = bootstrap(
            samples,
            statistic,
            paired=True,
            n_resamples=RESAMPLES,
            method="BCa",
            rng=np.random.default_rng(0),
        )
    return Interval(value, float(result.confidence_interval.low), float(result.confidence_interval.high))
