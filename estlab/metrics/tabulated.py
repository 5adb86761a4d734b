"""The tables of an ensemble, by column or by row, from its sums."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from estlab.maths.space import Array
from estlab.metrics.consistency import BIAS, FEWEST, NEES, NIS, WHITENESS, Test, intervals_of_all, nees_of
from estlab.metrics.credibility import credibility
from estlab.metrics.intervals import (
    LEVEL,
    Estimate,
    mean_interval,
    positive_interval,
    share_interval,
    time_share_interval,
)
from estlab.metrics.laws import SIGMAS, within
from estlab.metrics.moments import SampleMoments
from estlab.metrics.scores import quietly
from estlab.metrics.tally import CAUSES, Tally
from estlab.metrics.verdict import Verdict
from estlab.metrics.vocabulary import unit_of

Columns = dict[str, Array]

ERRORS = "errors"  # the group of metrics that every run needs


class MetricRow(NamedTuple):
    """A tidy row: a metric of a component, a mean over n independent runs with its 95 % interval.

    Figures that a test judges (anees, anis, normalised_bias, innovation_correlation) have the test's interval.
    """

    metric: str
    component: str
    unit: str
    value: float
    ci_low: float
    ci_high: float
    n: int

    @property
    def estimate(self) -> Estimate:
        """Value, interval and number of runs."""
        return Estimate(self.value, self.ci_low, self.ci_high, self.n)


def _row(metric: str, component: str, found: Estimate, component_unit: str = "") -> MetricRow:
    return MetricRow(metric, component, unit_of(metric, component_unit), *found)


def _count(metric: str, value: float, n: int) -> MetricRow:
    return _row(metric, "all", Estimate(value, np.nan, np.nan, n))


def metric_rows(tally: Tally, tests: Sequence[Test], verdict: Verdict, bound: Array | None = None) -> list[MetricRow]:
    """Every figure of an ensemble except its tests. bound: (n, n, T), the Cramer-Rao bound, if there is one."""
    return [row for make in metric_groups(tally, tests, verdict, bound).values() for row in make()]


def metric_groups(
    tally: Tally, tests: Sequence[Test], verdict: Verdict | None, bound: Array | None = None
) -> dict[str, Callable[[], list[MetricRow]]]:
    """The same in groups, by name, each made when called; without a verdict it has no row."""

    def made(rows: Callable[[], Iterable[MetricRow]]) -> Callable[[], list[MetricRow]]:
        return quietly(lambda: [_unsure(row) if tally.repeated else row for row in rows()])

    return {
        ERRORS: made(lambda: _errors(tally)),
        "judged figures": made(lambda: _judged(tally, {test.name: test for test in tests})),
        "shares inside": made(lambda: _all_components(tally)),
        "credibility": made(lambda: _credibility(tally)),
        "likelihood": made(lambda: _innovations(tally)),
        "efficiency": made(lambda: _efficiency(tally, bound)),
        "found": made(lambda: _found(tally)),
        "the filter's notes": made(lambda: _noted(tally)),
        "diverged runs": made(lambda: _diverged(tally)),
        "verdict": made(lambda: [] if verdict is None else [_verdict(tally, verdict)]),
    }


def _unsure(row: MetricRow) -> MetricRow:
    return row._replace(ci_low=np.nan, ci_high=np.nan)


def _diverged(tally: Tally) -> Iterator[MetricRow]:
    for cause in CAUSES:
        yield _count(cause, tally.diverged[cause], tally.runs)
    yield _count("diverged", sum(tally.diverged.values()), tally.runs)


def _verdict(tally: Tally, verdict: Verdict) -> MetricRow:
    return _row("verdict", verdict.word, Estimate(verdict.p, np.nan, np.nan, tally.runs))


def _errors(tally: Tally) -> Iterator[MetricRow]:
    space, moments = tally.space, tally.moments
    each = list(enumerate(zip(space.names, space.units, strict=True)))
    for metric, square in (("rmse", "mean_square"), ("rmse_converged", "mean_square_converged")):
        for i, (name, unit) in each:
            yield _row(metric, name, _root(positive_interval(moments[square].at(i))), unit)
        if "position_square" in moments:
            unit = space.units[space.position[0]]
            whole = moments[square.replace("mean_square", "position_square")]
            yield _row(metric, "position", _root(positive_interval(whole)), unit)
        if "state_square" in moments:
            every = moments[square.replace("mean_square", "state_square")]
            yield _row(metric, "all", _root(positive_interval(every)), space.units[0])
    for metric in ("median_abs_error", "mean_error", "mean_sigma"):
        for i, (name, unit) in each:
            yield _row(metric, name, mean_interval(moments[metric].at(i)), unit)
    for i, (name, _) in each:
        yield _row("inside_3sigma", name, time_share_interval(moments["inside"].at(2, i)))
    for i, (name, _) in each:
        yield _row("scored", name, _clipped(mean_interval(moments["scored"].at(i))))
    if "position_square" in moments:
        unit = space.units[space.position[0]]
        yield _row("median_abs_error", "position", mean_interval(moments["position_median"]), unit)
        yield _row("scored", "position", _clipped(mean_interval(moments["position_scored"])))


def _judged(tally: Tally, by: Mapping[str, Test]) -> Iterator[MetricRow]:
    """Figures that tests judge, with the intervals that the tests use; without intervals if a test needs more runs."""
    if not by:  # these could not be made, so the uncertainty is unknown
        return
    bias = intervals_of_all(tally.moments["bias"], _level(by[BIAS]))
    for name, found in zip(tally.space.names, bias, strict=True):
        yield _row("normalised_bias", name, _of_enough(found))
    yield _row("anees", "all", _of_enough(positive_interval(nees_of(tally)[1], _level(by[NEES]))))
    yield _row("anees_converged", "all", _of_enough(positive_interval(nees_of(tally, "_converged")[1])))
    if int(tally.moments["nis"].count):
        yield _row("anis", "all", by[NIS].found)
        for lag, found in enumerate(intervals_of_all(tally.moments["correlation"], _level(by[WHITENESS]))):
            yield _row("innovation_correlation", f"lag {lag + 1}", _of_enough(found))


def _of_enough(found: Estimate) -> Estimate:
    return found if found.n >= FEWEST else found._replace(low=np.nan, high=np.nan)


def _level(test: Test) -> float:
    """The level at which a test judges; the usual one if it could not be made."""
    return test.level if np.isfinite(test.level) else LEVEL


def _all_components(tally: Tally) -> Iterator[MetricRow]:
    moments = tally.moments
    yield _row("inside_3sigma", "all", time_share_interval(moments["inside"].at(2, tally.space.size)))
    yield _row("scored", "all", _clipped(mean_interval(moments["nees_scored"])))


def _credibility(tally: Tally) -> Iterator[MetricRow]:
    if not tally.repeated and not tally.sampled:
        index, inclination = credibility(*tally.first)
        yield _row("noncredibility", "all", index)
        yield _row("inclination", "all", inclination)


def _innovations(tally: Tally) -> Iterator[MetricRow]:
    moments = tally.moments
    if int(moments["anis"].count):
        yield _row("loglik", "all", mean_interval(moments["loglik"]))


def _efficiency(tally: Tally, bound: Array | None) -> Iterator[MetricRow]:
    """Bound over RMSE: at most one, apart from chance. Its interval is that of the RMSE.

    None if runs broke: their RMSE covers the steps before, the bound covers all.
    """
    if bound is None or tally.diverged["not_finite"] or tally.diverged["not_definite"]:
        return
    variance = np.einsum("iit->it", bound)
    parts = [(name, variance[i], tally.moments["mean_square"].at(i)) for i, name in enumerate(tally.space.names)]
    if tally.space.position:
        at = list(tally.space.position)
        parts.append(("position", variance[at].sum(axis=0), tally.moments["position_square"]))
    for name, least, moments in parts:
        found, root = positive_interval(moments), np.sqrt(least.mean())
        value, low, high = (float(root / np.sqrt(x)) for x in (found.value, found.high, found.low))
        yield _row("efficiency", name, Estimate(value, low, high, found.n))


def _found(tally: Tally) -> Iterator[MetricRow]:
    if "found" in tally.moments:
        share = tally.moments["found"]
        yield _row("found", "position", share_interval(float(share.mean[0]), int(share.count)))
        yield _row("found_time", "position", mean_interval(tally.moments["found_time"]))


def _noted(tally: Tally) -> Iterator[MetricRow]:
    for name in ("gated", "vanished"):
        if (noted := tally.sums.get(f"note_{name}")) is not None and noted.any():
            yield _count(name, int(noted.sum()), tally.runs)
    if "ess" in tally.moments:
        yield _row("ess", "all", mean_interval(tally.moments["ess"]))


def test_rows(tests: Sequence[Test]) -> list[dict[str, object]]:
    """One line per test."""
    return [
        {
            "test": test.name,
            "of": test.of,
            "value": test.found.value,
            "ci_low": test.found.low,
            "ci_high": test.found.high,
            "expected": test.expected,
            "p": test.p,
            "p_holm": test.adjusted,
            "n": test.found.n,
            "outcome": _outcome(test),
            "level": test.level,
        }
        for test in tests
    ]


def _outcome(test: Test) -> str:
    if np.isnan(test.p):
        return f"not available: {test.why or 'nothing varies'}"
    return "rejected" if test.rejected else "not rejected"


def coverage_rows(tally: Tally) -> list[dict[str, object]]:
    """Shares within 1, 2, 3 sigma of each component and of all jointly, over all steps and at the last."""
    rows = []
    for when, share in (("all steps", tally.moments["inside"]), ("last step", tally.moments["inside_last"])):
        for i, name in enumerate((*tally.space.names, "all")):
            for k, sigmas in enumerate(SIGMAS):
                found = _share_of_runs(share.at(k, i)) if when == "last step" else time_share_interval(share.at(k, i))
                low, high = (np.nan, np.nan) if tally.repeated else (found.low, found.high)
                rows.append(
                    {
                        "when": when,
                        "component": name,
                        "sigmas": sigmas,
                        "nominal": within(sigmas),
                        "share": found.value,
                        "ci_low": low,
                        "ci_high": high,
                        "n": found.n,
                    }
                )
    return rows


def histogram_rows(tally: Tally) -> list[dict[str, object]]:
    """How many runs have an RMSE, and a mean NEES / n, within which limits; bins without runs are left out."""
    rows = []
    parts = [("rmse", name, tally.histograms["mean_square"].counts[i]) for i, name in enumerate(tally.space.names)]
    if "position_square" in tally.histograms:
        parts.append(("rmse", "position", tally.histograms["position_square"].counts))
    parts.append(("anees", "all", tally.histograms["anees"].counts))
    edges = tally.histograms["anees"].edges()
    for metric, component, counts in parts:
        for i in np.flatnonzero(counts):
            rows.append(
                {
                    "metric": metric,
                    "component": component,
                    "low": edges[i],
                    "high": edges[i + 1],
                    "runs": int(counts[i]),
                }
            )
    return rows


def _share_of_runs(moments: SampleMoments) -> Estimate:
    n = int(moments.count)
    return share_interval(float(moments.mean[0]) if n else np.nan, n)


def _root(estimate: Estimate) -> Estimate:
    """The root of a mean square; its interval is the root of the mean square's."""
    value, low, high, n = estimate
    return Estimate(float(np.sqrt(value)), float(np.sqrt(low)), float(np.sqrt(high)), n)


def _clipped(estimate: Estimate) -> Estimate:
    value, low, high, n = estimate
    value = min(value, 1.0)  # rounding may push a sum of shares of time just past one
    return Estimate(value, max(low, 0.0) if np.isfinite(low) else low, min(high, 1.0) if np.isfinite(high) else high, n)
