"""Is a filter what it says it is: tests over independent runs, each with 5 % of false alarms.

Steps of one run are correlated, so a test never counts them as if they were independent: each run answers once, and the
test is over the runs. Only innovations, which a right filter leaves white, are also counted within a run.
"""

from typing import NamedTuple

import numpy as np

from estlab.maths.space import Array
from estlab.metrics.intervals import (
    LEVEL,
    Estimate,
    chi_square_band,
    chi_square_test,
    holm,
    hotelling_test,
    mean_interval,
    positive_interval,
    positive_test,
    t_test,
)
from estlab.metrics.moments import Moments
from estlab.metrics.scores import LAGS
from estlab.metrics.tally import Tally

_FEWEST = 5  # runs for a test over runs
_LAWFUL = 0.95  # share of the steps at which a sampled covariance must have a law
_SINGLE_LAGS = 20
_NO_INNOVATIONS = "there are no innovations"

NEES, NIS, BIAS, WHITENESS = "nees", "nis", "bias", "whiteness"


class Test(NamedTuple):
    """One test of one filter.

    of: what the value is of, where there are several. expected: of a consistent filter. p: of the test; adjusted: for
    there being several tests (Holm). why: the reason where there is no answer, p being NaN.
    """

    name: str
    of: str
    found: Estimate
    expected: float
    p: float
    adjusted: float = np.nan
    why: str = ""

    @property
    def rejected(self) -> bool:
        """Whether it fails, all tests together having 5 % of false alarms."""
        return bool(self.adjusted < LEVEL)


def consistency_tests(tally: Tally) -> list[Test]:
    """NEES, NIS, bias and whiteness, in this order."""
    tests = [_nees(tally), _nis(tally), _bias(tally), _whiteness(tally)]
    adjusted = holm(np.array([test.p for test in tests]))
    return [test._replace(adjusted=float(p)) for test, p in zip(tests, adjusted, strict=True)]


def _nees(tally: Tally) -> Test:
    """Each run's mean NEES over its law's is one on average. Bar-Shalom, Li and Kirubarajan 2001, section 5.4.2."""
    moments = tally.moments["nees"]
    found = positive_interval(moments)
    of = "expected" if tally.sampled else "n"
    if why := _too_few(tally, tally.runs) or sample_too_small(tally) or _too_few(tally, found.n):
        return _unanswered(NEES, of, found, 1.0, why)
    return Test(NEES, of, found, 1.0, positive_test(moments, 1.0))


def _nis(tally: Tally) -> Test:
    """NIS over its law's mean is one on average; over all innovations of few runs, a chi-square.

    The mean is the numbers measured, or less with a gate. What a gate takes off the variance is not allowed for: with
    few runs the test is then somewhat too lenient.
    """
    moments, of = tally.moments["nis"], "expected" if tally.gated else "m"
    found = positive_interval(moments)
    if found.n == 0:
        return _unanswered(NIS, of, found, 1.0, _NO_INNOVATIONS)
    if not _too_few(tally, found.n):
        return Test(NIS, of, found, 1.0, positive_test(moments, 1.0))
    # Of all innovations, not the mean of the runs' means: a run with few of them says little.
    freedom, runs = float(tally.sums["measured"].sum()), found.n
    value = float(tally.sums["nis"].sum() / tally.sums["nis_mean"].sum())
    if tally.repeated:
        freedom, runs = freedom / found.n, 1
    lower, upper = chi_square_band(np.array(freedom))
    # The interval of a scale: where the total would lie in the band of a filter whose NIS is that much larger.
    interval = Estimate(value, value / float(upper), value / float(lower), runs)
    return Test(NIS, of, interval, 1.0, chi_square_test(value * freedom, freedom))


def _bias(tally: Tally) -> Test:
    """Each run's mean of error over sigma is zero on average, in all components at once.

    The normalised mean estimation error of Bar-Shalom, Li and Kirubarajan 2001, section 5.4.2, averaged over time
    within a run and tested over runs by Hotelling's T squared. The value is that of the component furthest from zero.
    """
    moments = tally.moments["bias"]
    worst, found = _furthest(moments)
    if why := _too_few(tally, int(moments.count)) or _too_few_for(moments):
        return _unanswered(BIAS, tally.space.names[worst], found, 0.0, why)
    return Test(BIAS, tally.space.names[worst], found, 0.0, hotelling_test(moments))


def _whiteness(tally: Tally) -> Test:
    """Whitened innovations do not correlate with those before. Over runs by Hotelling's T squared; in one by Ljung-Box.

    The value is the correlation at the lag where it is furthest from zero.
    """
    moments = tally.moments["correlation"]
    first = mean_interval(moments.leading(1))
    if not tally.sums["measured"].any():
        return _unanswered(WHITENESS, "lag 1", first, 0.0, _NO_INNOVATIONS)
    if not _too_few(tally, int(moments.count)):
        tried = moments.leading(int(np.clip(int(moments.count) // 5, 1, LAGS)))
        worst, found = _furthest(tried)
        return Test(WHITENESS, f"lag {worst + 1}", found, 0.0, hotelling_test(tried))
    whitened = tally.first_whitened
    whitened = whitened[:, np.isfinite(whitened).all(axis=0)]
    if whitened.shape[1] < 3 * _SINGLE_LAGS:
        enough = not _too_few(tally, tally.runs)
        why = f"{_FEWEST} runs of {4 * LAGS} readings" if enough else f"{_FEWEST} runs, or {3 * _SINGLE_LAGS} readings"
        return _unanswered(WHITENESS, "lag 1", first, 0.0, f"needs {why}{'' if enough else ' in one'}")
    each, p = ljung_box(whitened, _SINGLE_LAGS)
    worst = int(np.argmax(np.abs(each)))
    found = single_correlation(float(each[worst]), whitened.size, _SINGLE_LAGS)
    return Test(WHITENESS, f"lag {worst + 1}", found, 0.0, p)


def single_correlation(value: float, count: int, among: int) -> Estimate:
    """One of several correlations of so many innovations of one run, for an interval that all of them hold with 95 %.

    A correlation of white innovations has variance 1 / count; Bonferroni for the number of correlations.
    """
    from scipy.special import ndtri

    half = float(ndtri(1.0 - LEVEL / (2.0 * among))) / np.sqrt(count)
    return Estimate(value, value - half, value + half, 1)


def ljung_box(whitened: Array, lags: int) -> tuple[Array, float]:
    """Correlations at lags 1, 2, ... and p-value of the Ljung-Box test of one run's whitened innovations (m, N).

    N (N + 2) sum r_l^2 / (N - l) of each component is a chi-square with as many degrees of freedom as lags, and
    components are independent. The mean is zero by hypothesis, so none is subtracted. Ljung and Box 1978.
    """
    m, count = whitened.shape
    squares = (whitened**2).sum(axis=1)
    products = np.stack([(whitened[:, lag:] * whitened[:, : count - lag]).sum(axis=1) for lag in range(1, lags + 1)])
    each = products / squares
    statistic = count * (count + 2) * (each**2 / (count - np.arange(1, lags + 1))[:, None]).sum()
    from scipy.special import chdtrc

    return products.sum(axis=1) / squares.sum(), float(chdtrc(m * lags, statistic))


def _furthest(moments: Moments) -> tuple[int, Estimate]:
    """The component whose mean is furthest from zero, and its mean's interval among all.

    Of those whose interval leaves out zero; where none does, the furthest in its own standard errors, if it has any.
    """
    count = moments.mean.shape[0]
    each = [mean_interval(moments.component(i), among=count) for i in range(count)]
    away = np.nan_to_num([2.0 * abs(found.value) / max(found.high - found.low, 1e-300) for found in each])
    size = np.abs(moments.mean)
    if (away > 1.0).any():
        away = np.where(away > 1.0, size, 0.0)
    elif not away.any():
        away = size
    worst = int(np.argmax(away))
    return worst, each[worst]


def _too_few(tally: Tally, runs: int) -> str:
    if tally.repeated:
        return "one recording is one run"
    return "" if runs >= _FEWEST else f"needs {_FEWEST} runs"


def _too_few_for(moments: Moments) -> str:
    needed = moments.mean.shape[0] + 3
    return "" if int(moments.count) >= needed else f"needs {needed} runs"


def sample_too_small(tally: Tally) -> str:
    """What to say of a sampled covariance whose NEES has no law at too many steps; empty where it has."""
    lawful = tally.moments["lawful"]
    if not tally.sampled or not int(lawful.count) or lawful.mean[0] >= _LAWFUL:
        return ""
    return f"the sample is too small at {1.0 - float(lawful.mean[0]):.0%} of the steps"


def explained_by_bias(tally: Tally) -> float:
    """By how much the mean error makes NEES over n too large: the square of the mean of L^-1 e over n, P = L L'.

    Less what chance adds to the square of a mean over runs.
    """
    moments = tally.moments["scaled"]
    square = moments.mean @ moments.mean - np.trace(moments.cov) / moments.count
    return float(square) / moments.mean.size


def _unanswered(name: str, of: str, found: Estimate, expected: float, why: str) -> Test:
    return Test(name, of, found._replace(low=np.nan, high=np.nan), expected, np.nan, why=why)


def component_biases(tally: Tally) -> list[tuple[str, Estimate, float]]:
    """Mean of error over sigma of each component, its interval and p-value."""
    moments = tally.moments["bias"]
    parts = [moments.component(i) for i in range(moments.mean.shape[0])]
    return [(n, mean_interval(p), t_test(p, 0.0)) for n, p in zip(tally.space.names, parts, strict=True)]
