"""Tests of whether a filter's stated uncertainty is honest, over independent runs, with 5 % of false alarms in total.

Steps of one run are correlated, so a test never counts them as independent: each run contributes one number, and the
test is over the runs. Only innovations, which a correct filter leaves white, are also counted within a run.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from estlab.maths.space import Array
from estlab.metrics.intervals import (
    LEVEL,
    Estimate,
    chi_square_band,
    chi_square_test,
    holm,
    judged_at,
    mean_interval,
    positive_interval,
    positive_test,
    t_test,
    time_share_interval,
    time_share_test,
)
from estlab.metrics.moments import SampleMoments
from estlab.metrics.scores import LAGS
from estlab.metrics.tally import Tally

FEWEST = 5  # runs needed for a test over runs
_LAWFUL = 0.95  # share of the steps at which the distribution of a sampled covariance must be known
_SINGLE_LAGS = 20

# The smallest share of errors of any distribution within three of its standard deviations: Chebyshev's inequality.
LEAST_INSIDE = 1.0 - 1.0 / 9.0

NEES, NIS, BIAS, WHITENESS, INSIDE = "nees", "nis", "bias", "whiteness", "inside_3sigma"


class Test(NamedTuple):
    """One test of one filter.

    of: which of several values this is. found: with the interval that excludes the expected value exactly where the
    test rejects. expected: for a consistent filter. p: of the test; adjusted: for the number of tests (Holm). level:
    at which Holm's method judges the test, which is also the interval's. why: the reason if there is no answer; p is
    then NaN.
    """

    name: str
    of: str
    found: Estimate
    expected: float
    p: float
    adjusted: float = np.nan
    level: float = np.nan
    why: str = ""

    @property
    def rejected(self) -> bool:
        """Whether the test rejects, with 5 % of false alarms for all tests together."""
        return bool(self.adjusted < LEVEL)


@dataclass(frozen=True)
class _Asked:
    """A test before its level is known. at_level: the name and the value at a level."""

    name: str
    expected: float
    p: float
    at_level: Callable[[float], tuple[str, Estimate]]
    why: str = ""


def consistency_tests(tally: Tally) -> list[Test]:
    """NEES, NIS, bias and whiteness, in this order; and the shares inside 3 sigma where NEES cannot be judged."""
    asked = [_nees(tally), _nis(tally), _bias(tally), _whiteness(tally), *_inside(tally)]
    p_values = np.array([np.nan if one.why else one.p for one in asked])
    adjusted, levels = holm(p_values), judged_at(p_values)
    return [_answered(*each) for each in zip(asked, adjusted, levels, strict=True)]


def _answered(asked: _Asked, adjusted: float, level: float) -> Test:
    answer = np.isfinite(level)
    of, found = asked.at_level(float(level) if answer else LEVEL)
    if not answer:
        why = asked.why or "nothing varies"
        return Test(asked.name, of, found._replace(low=np.nan, high=np.nan), asked.expected, np.nan, why=why)
    return Test(asked.name, of, found, asked.expected, asked.p, float(adjusted), float(level))


def nees_of(tally: Tally, which: str = "") -> tuple[str, SampleMoments]:
    """What NEES is divided by, and each run's quotient: n, or the mean of its distribution for sampled covariances.

    Uses only steps at which the distribution is known; if too many have none, uses all steps and divides by n. which:
    "_converged" for those runs only.
    """
    if tally.sampled and not sample_too_small(tally):
        return "expected", tally.moments[f"nees{which}"]
    return "n", tally.moments[f"anees{which}"]


def _nees(tally: Tally) -> _Asked:
    """Each run's mean NEES over its expectation averages one. Bar-Shalom, Li and Kirubarajan 2001, section 5.4.2."""
    of, moments = nees_of(tally)
    why = _unscored(tally, moments) or _too_few(tally, tally.runs) or sample_too_small(tally)
    why = why or _too_few(tally, moments.count)
    return _Asked(NEES, 1.0, positive_test(moments, 1.0), lambda level: (of, positive_interval(moments, level)), why)


def _nis(tally: Tally) -> _Asked:
    """NIS over its expectation averages one; over all innovations of few runs it is a chi-square.

    The expectation is the number of values measured, or less with a gate. The reduced variance with a gate is not
    accounted for: with few runs the test is then somewhat too lenient.
    """
    moments, of = tally.moments["nis"], "expected" if tally.gated else "m"
    runs = int(moments.count)
    if runs == 0 or not _too_few(tally, runs):
        why = "" if runs else _no_innovations(tally)
        return _Asked(NIS, 1.0, positive_test(moments, 1.0), lambda level: (of, positive_interval(moments, level)), why)
    # The mean over all innovations, not over the runs' means: a run with few innovations says little.
    freedom = float(tally.sums["measured"].sum()) / (runs if tally.repeated else 1)
    value = float(tally.sums["nis"].sum() / tally.sums["nis_mean"].sum())

    def at_level(level: float) -> tuple[str, Estimate]:
        # The interval of a scale: where the total would lie in the band of a filter whose NIS is larger by that
        # factor.
        lower, upper = (float(bound) for bound in chi_square_band(np.array(freedom), level))
        return of, Estimate(value, value / upper, value / lower, 1 if tally.repeated else runs)

    return _Asked(NIS, 1.0, chi_square_test(value * freedom, freedom), at_level)


def _bias(tally: Tally) -> _Asked:
    """Each run's mean of error over sigma averages zero, in every component.

    The normalised mean estimation error of Bar-Shalom, Li and Kirubarajan 2001, section 5.4.2, averaged over time
    within a run and tested over runs, with Student's t for each component and a Bonferroni correction.
    """
    moments, names = tally.moments["bias"], tally.space.names
    why = _unscored(tally, moments) or _too_few(tally, tally.runs) or _too_few(tally, moments.count)
    return _Asked(BIAS, 0.0, _any_off_zero(moments), lambda level: _furthest(moments, names, level), why)


def _whiteness(tally: Tally) -> _Asked:
    """Whitened innovations do not correlate with earlier ones, at any lag; tested over runs, or by their distribution
    in one.

    The value is the correlation furthest from zero.
    """
    moments = tally.moments["correlation"]
    names = [f"lag {lag + 1}" for lag in range(LAGS)]
    nothing = names[0], mean_interval(moments.component(0))
    if not tally.sums["measured"].any():
        return _Asked(WHITENESS, 0.0, np.nan, lambda level: nothing, _no_innovations(tally))
    if not _too_few(tally, moments.count):
        return _Asked(WHITENESS, 0.0, _any_off_zero(moments), lambda level: _furthest(moments, names, level))
    whitened = tally.first_whitened
    whitened = whitened[:, np.isfinite(whitened).all(axis=0)]
    if whitened.shape[1] < 3 * _SINGLE_LAGS:
        enough = not _too_few(tally, tally.runs)
        why = f"{FEWEST} runs of {4 * LAGS} readings" if enough else f"{FEWEST} runs, or {3 * _SINGLE_LAGS} readings"
        why = f"needs {why}{'' if enough else ' in one'}"
        return _Asked(WHITENESS, 0.0, np.nan, lambda level: nothing, why)
    each, deviation = single_correlations(whitened, _SINGLE_LAGS)
    from scipy.special import ndtr, ndtri

    away = np.abs(each) / deviation
    worst = int(np.argmax(away))
    p = min(1.0, float(_SINGLE_LAGS * 2.0 * ndtr(-away[worst])))

    def at_level(level: float) -> tuple[str, Estimate]:
        half = float(deviation[worst] * ndtri(1.0 - level / (2.0 * _SINGLE_LAGS)))
        return f"lag {worst + 1}", Estimate(float(each[worst]), float(each[worst]) - half, float(each[worst]) + half, 1)

    return _Asked(WHITENESS, 0.0, p, at_level)


def single_correlations(whitened: Array, lags: int) -> tuple[Array, Array]:
    """Correlations of one run's whitened innovations (m, N) at lags 1, 2, ..., and the standard deviation of each if
    white.

    For m N independent standard normal numbers, the sum of m (N - l) products over the sum of their squares has
    variance (N - l) / (N (m N + 2)), because the quotient is independent of its denominator. The mean is zero by
    hypothesis, so none is subtracted. Ljung and Box 1978, equation 2.2, is the case m = 1.
    """
    m, count = whitened.shape
    products = np.stack([(whitened[:, lag:] * whitened[:, : count - lag]).sum() for lag in range(1, lags + 1)])
    return products / (whitened**2).sum(), np.sqrt((count - np.arange(1, lags + 1)) / (count * (m * count + 2.0)))


def _inside(tally: Tally) -> list[_Asked]:
    """If NEES has no known distribution: the component with fewer errors within 3 sigma than any distribution allows,
    if any.

    If three standard deviations hold less than eight ninths of the errors, the standard deviation is too small,
    whatever the distribution of the errors and however the cloud came about.
    """
    if not sample_too_small(tally) or _too_few(tally, tally.runs):
        return []
    parts = [tally.moments["inside"].at(2, i) for i in range(tally.space.size)]
    below = [i for i, part in enumerate(parts) if int(part.count) >= FEWEST and part.mean[0] < LEAST_INSIDE]
    if not below:
        return []
    p_values = [time_share_test(parts[i], LEAST_INSIDE) for i in below]
    worst, among = below[int(np.argmin(p_values))], len(parts)

    def at_level(level: float) -> tuple[str, Estimate]:
        return tally.space.names[worst], time_share_interval(parts[worst], level / among)

    return [_Asked(INSIDE, LEAST_INSIDE, min(1.0, among * min(p_values)), at_level)]


def _any_off_zero(moments: SampleMoments) -> float:
    """The p-value for all of several means being zero: the smallest of Student's t, times their number (Bonferroni).

    It is below a level exactly where one of their intervals, of that level over their number, excludes zero.
    """
    count = moments.mean.shape[0]
    each = np.array([t_test(moments.component(i), 0.0) for i in range(count)])
    return min(1.0, count * float(np.nanmin(each))) if np.isfinite(each).any() else np.nan


def _furthest(moments: SampleMoments, names: Sequence[str], level: float) -> tuple[str, Estimate]:
    """The name of the mean that is furthest from zero, and its interval, such that all intervals hold together.

    Chosen among those whose interval excludes zero; if none does, the furthest in units of its own standard error, if
    known.
    """
    each = intervals_of_all(moments, level)
    away = np.nan_to_num([2.0 * abs(found.value) / max(found.high - found.low, 1e-300) for found in each])
    size = np.abs(moments.mean)
    if (away > 1.0).any():
        away = np.where(away > 1.0, size, 0.0)
    elif not away.any():
        away = size
    worst = int(np.argmax(away))
    return names[worst], each[worst]


def intervals_of_all(moments: SampleMoments, level: float) -> list[Estimate]:
    """Each mean with an interval; all hold together except with probability ``level`` (Bonferroni)."""
    count = moments.mean.shape[0]
    return [mean_interval(moments.component(i), level / count) for i in range(count)]


def _too_few(tally: Tally, runs: int | Array) -> str:
    if tally.repeated:
        return "one recording is one run"
    return "" if int(runs) >= FEWEST else f"needs {FEWEST} runs"


def _no_innovations(tally: Tally) -> str:
    return "no reading passed the gate" if tally.gated else "there are no innovations"


def _unscored(tally: Tally, moments: SampleMoments) -> str:
    if int(moments.count):
        return ""
    if tally.diverged["not_definite"]:
        return "no covariance is definite"
    return "no estimate is finite" if tally.diverged["not_finite"] else "the truth is unknown"


def sample_too_small(tally: Tally) -> str:
    """The remark for a sampled covariance whose NEES has no known distribution at too many steps; otherwise empty."""
    lawful = tally.moments["lawful"]
    if not tally.sampled or not int(lawful.count) or lawful.mean[0] >= _LAWFUL:
        return ""
    return f"the sample is too small at {100.0 * (1.0 - float(lawful.mean[0])):.0f} % of the steps"


def explained_by_bias(tally: Tally) -> float:
    """By how much the mean error increases NEES over n: the square of the mean of L^-1 e over n, P = L L'.

    Corrected for what chance adds to the square of a mean over runs.
    """
    moments = tally.moments["scaled"]
    square = moments.mean @ moments.mean - np.trace(moments.cov) / moments.count
    return float(square) / moments.mean.size
