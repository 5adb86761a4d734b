"""Intervals, bands and tests over independent runs, at 95 % unless stated otherwise."""

from typing import NamedTuple

import numpy as np

from estlab.maths.space import Array
from estlab.metrics.moments import SampleMoments

LEVEL = 0.05  # of a test: its rate of false alarms
CONFIDENCE = 1.0 - LEVEL  # of an interval or a band


class Estimate(NamedTuple):
    """A mean over independent runs, its interval (NaN for fewer than two runs) and the number of runs."""

    value: float
    low: float
    high: float
    n: int


def mean_interval(moments: SampleMoments, level: float = LEVEL) -> Estimate:
    """Student's t interval for a mean over runs, with miss probability ``level``."""
    mean, error, n = _parts(moments)
    half = _t_quantile(n, level) * error
    return Estimate(mean, mean - half, mean + half, n)


def widened(found: Estimate, level: float) -> Estimate:
    """A 95 % interval of :func:`mean_interval` converted to another level."""
    factor = _t_quantile(found.n, level) / _t_quantile(found.n, LEVEL)
    value, low, high, n = found
    return Estimate(value, value - (value - low) * factor, value + (high - value) * factor, n)


def positive_interval(moments: SampleMoments, level: float = LEVEL) -> Estimate:
    """The same on a logarithmic scale, by the delta method: a mean of positive values cannot reach zero.

    For values as skewed as chi-squares it has its nominal coverage from five runs on, where Student's does not
    (docs/statistics.md).
    """
    mean, error, n = _parts(moments)
    if n < 2 or not mean > 0.0:
        return mean_interval(moments, level)
    stretch = stretched(error / mean, n, level)
    return Estimate(mean, mean / stretch, mean * stretch, n)


def stretched(relative_error: float, n: int, level: float) -> float:
    """The factor by which the interval of a mean of positive values reaches up and down, for n runs with this error."""
    return float(np.exp(min(_t_quantile(n, level) * relative_error, 50.0)))


def t_test(moments: SampleMoments, expected: float) -> float:
    """The two-sided p-value of a mean: below a level exactly where :func:`mean_interval` excludes ``expected``."""
    mean, error, n = _parts(moments)
    return _t_tail((mean - expected) / error, n) if error > 0.0 else np.nan


def positive_test(moments: SampleMoments, expected: float) -> float:
    """The two-sided p-value of a mean of positive values, consistent with :func:`positive_interval`."""
    mean, error, n = _parts(moments)
    return _t_tail(np.log(mean / expected) * mean / error, n) if error > 0.0 and mean > 0.0 else np.nan


def share_interval(share: float, n: float, level: float = LEVEL) -> Estimate:
    """Wilson's interval for the share of n independent runs with some property. Brown, Cai and DasGupta 2001.

    n may be an effective number, not an integer.
    """
    from scipy.special import ndtri

    if not n > 0.0:
        return Estimate(np.nan, np.nan, np.nan, 0)
    z2 = float(ndtri(1.0 - level / 2.0)) ** 2
    middle = (share + z2 / (2 * n)) / (1 + z2 / n)
    half = np.sqrt(z2 * (share * (1 - share) / n + z2 / (4 * n * n))) / (1 + z2 / n)
    return Estimate(share, float(min(middle - half, share)), float(max(middle + half, share)), round(n))


def time_share_interval(moments: SampleMoments, level: float = LEVEL) -> Estimate:
    """Wilson's interval for a share of time, as a mean over runs with many steps each.

    The steps of a run are not independent, so the share counts as that of as many independent trials as would have
    the variance that the runs show, reduced by (normal / Student's quantile)^2 because that variance is itself an
    estimate. Korn and Graubard 1998, section 2. If all runs agree there is one trial per run.
    """
    from scipy.special import ndtri

    share, trials, n = _trials(moments)
    if n > 1 and trials != n:
        trials *= (float(ndtri(1.0 - level / 2.0)) / _t_quantile(n, level)) ** 2
    found = share_interval(share, trials if n > 1 else 0, level)
    return Estimate(share if n else np.nan, found.low, found.high, n)


def time_share_test(moments: SampleMoments, expected: float) -> float:
    """The two-sided p-value of a share of time, consistent with :func:`time_share_interval`."""
    from scipy.special import ndtr

    share, trials, n = _trials(moments)
    away = abs(share - expected) * np.sqrt(trials / (expected * (1.0 - expected)))
    if n < 2:
        return np.nan
    return _t_tail(away, n) if trials != n else float(2.0 * ndtr(-away))


def chi_square_band(freedom: Array, level: float = LEVEL) -> tuple[Array, Array]:
    """The band of a chi-square over its degrees of freedom, with miss probability ``level``: lower and upper, NaN for
    no freedom.

    Bar-Shalom, Li and Kirubarajan 2001, section 5.4.2.
    """
    from scipy.special import gammaincinv

    freedom = np.where(np.asarray(freedom) > 0, freedom, np.nan)
    distinct, place = np.unique(freedom, return_inverse=True)  # few distinct values along a recording of many steps
    lower, upper = (
        (2.0 * gammaincinv(0.5 * distinct, p) / distinct)[place.reshape(freedom.shape)]
        for p in (0.5 * level, 1.0 - 0.5 * level)
    )
    return lower, upper


def chi_square_test(total: float, freedom: float) -> float:
    """The two-sided p-value of a chi-square: twice the smaller tail."""
    from scipy.special import chdtr, chdtrc

    return float(min(1.0, 2.0 * min(chdtr(freedom, total), chdtrc(freedom, total)))) if freedom > 0 else np.nan


def holm(p_values: Array) -> Array:
    """p-values adjusted so that, if nothing is wrong, any of them is below 5 % in at most 5 % of the cases. Holm
    1979.

    NaN stays NaN and is not counted.
    """
    p_values = np.asarray(p_values, dtype=float)
    adjusted = np.full(p_values.shape, np.nan)
    known = np.flatnonzero(np.isfinite(p_values))
    order = known[np.argsort(p_values[known], kind="stable")]
    factors = np.arange(order.size, 0, -1)
    adjusted[order] = np.minimum(np.maximum.accumulate(factors * p_values[order]), 1.0)
    return adjusted


def judged_at(p_values: Array) -> Array:
    """The level at which Holm's method judges each p-value, as :func:`holm` adjusts them; NaN for NaN.

    An interval of that level excludes the expected value exactly where its test rejects: one error rate decides both.
    Rejected values are judged at 5 % over m, m - 1, ...; all others at the level at which the method stopped.
    """
    adjusted, levels = holm(p_values), np.full(np.shape(p_values), np.nan)
    known = np.flatnonzero(np.isfinite(adjusted))
    order = known[np.argsort(np.asarray(p_values)[known], kind="stable")]
    rejected = int((adjusted[order] < LEVEL).sum())
    levels[order] = LEVEL / np.maximum(order.size - np.minimum(np.arange(order.size), rejected), 1)
    return levels


def _trials(moments: SampleMoments) -> tuple[float, float, int]:
    """A share of time, the number of independent trials with the runs' variance, and the number of runs."""
    mean, error, n = _parts(moments)
    share = min(max(mean, 0.0), 1.0)  # rounding may push a sum of shares of time just past one
    return share, share * (1.0 - share) / error**2 if n > 1 and error > 1e-12 else float(n), n


def _parts(moments: SampleMoments) -> tuple[float, float, int]:
    """Mean, standard error and number of runs, from the moments of single numbers."""
    n = int(moments.count)
    mean = float(moments.mean[0]) if n else np.nan
    return mean, float(np.sqrt(moments.cov[0, 0] / max(n, 1))), n


def _t_quantile(n: int, level: float) -> float:
    from scipy.special import stdtrit

    return float(stdtrit(n - 1, 1.0 - level / 2.0)) if n > 1 else np.nan


def _t_tail(t: float, n: int) -> float:
    from scipy.special import stdtr

    return float(2.0 * stdtr(n - 1, -abs(t))) if n > 1 else np.nan
