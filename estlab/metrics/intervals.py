"""Intervals and bands at 95 %."""

from typing import NamedTuple

import numpy as np

from estlab.maths.space import Array

LEVEL = 0.95


class Estimate(NamedTuple):
    """A mean over independent runs, its interval (NaN for fewer than two runs) and the number of runs."""

    value: float
    low: float
    high: float
    n: int


def mean_interval(values: Array) -> Estimate:
    """Student's t interval for the mean of independent values (runs,); NaN among them are left out of value and n."""
    from scipy.special import stdtrit

    values = values[np.isfinite(values)]
    n = values.size
    if n == 0:
        return Estimate(np.nan, np.nan, np.nan, 0)
    mean = float(values.mean())
    if n == 1:
        return Estimate(mean, np.nan, np.nan, 1)
    half = float(stdtrit(n - 1, 0.5 + LEVEL / 2.0)) * float(values.std(ddof=1)) / np.sqrt(n)
    return Estimate(mean, mean - half, mean + half, n)


def positive_interval(values: Array) -> Estimate:
    """The same on the scale of logarithms, by the delta method: a mean of positive values cannot reach zero."""
    mean, low, high, n = mean_interval(values)
    if n < 2 or not mean > 0.0:
        return Estimate(mean, low, high, n)
    stretch = float(np.exp(min((high - mean) / mean, 50.0)))
    return Estimate(mean, mean / stretch, mean * stretch, n)


def share_interval(hits: Array) -> Estimate:
    """Wilson's interval for the share of independent runs (runs,) in which something holds. Brown et al. 2001."""
    from scipy.special import ndtri

    n = hits.size
    if n == 0:
        return Estimate(np.nan, np.nan, np.nan, 0)
    share, z2 = float(hits.mean()), float(ndtri(0.5 + LEVEL / 2.0)) ** 2
    middle = (share + z2 / (2 * n)) / (1 + z2 / n)
    half = np.sqrt(z2 * (share * (1 - share) / n + z2 / (4 * n * n))) / (1 + z2 / n)
    return Estimate(share, middle - half, middle + half, n)


def chi_square_band(freedom: Array) -> tuple[Array, Array]:
    """Where a chi-square over its degrees of freedom lies with 95 %: lower and upper, NaN for no freedom.

    Bar-Shalom, Li and Kirubarajan 2001, section 5.4.2.
    """
    from scipy.special import gammaincinv

    freedom = np.where(np.asarray(freedom) > 0, freedom, np.nan)
    tail = 0.5 * (1.0 - LEVEL)
    lower, upper = (2.0 * gammaincinv(0.5 * freedom, p) / freedom for p in (tail, 1.0 - tail))
    return lower, upper
