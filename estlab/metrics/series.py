"""The tables over time of an ensemble, by column."""

import numpy as np

from estlab.maths.space import Array
from estlab.metrics.intervals import CONFIDENCE, chi_square_band
from estlab.metrics.scores import quietly
from estlab.metrics.tabulated import Columns
from estlab.metrics.tally import Tally


@quietly
def errors(tally: Tally, first: tuple[Array, Array, Array], bound: Array | None = None) -> Columns:
    """A row for each time and component: a run's truth (n, T), mean (n, T), cov (n, n, T); the ensemble; the bound."""
    truth, mean, cov = first
    space, sums = tally.space, tally.sums
    n, steps = space.size, tally.time.size
    error = space.minus(mean, truth)
    sigma = np.sqrt(cov[range(n), range(n)])
    count = sums["scored"]
    rmse = np.sqrt(_ratio(sums["square"], count))
    stretch = _stretch(tally)
    nothing = np.full((n, steps), np.nan)
    grids = {
        "truth": truth,
        "estimate": mean,
        "error": error,
        "sigma": sigma,
        "lower3": -3.0 * sigma,
        "upper3": 3.0 * sigma,
        "mean_error": _ratio(sums["error"], count),
        "rmse": rmse,
        "rmse_low": rmse / stretch,
        "rmse_high": rmse * stretch,
        "bound": nothing if bound is None else np.sqrt(np.einsum("iit->it", bound)),
        "mean_sigma": _ratio(sums["sigma"], count),
        "inside_3sigma": _ratio(sums["inside"], count),
        "runs_scored": count,
    }
    return {
        "time": np.repeat(tally.time, n),
        "component": np.tile(space.names, steps),
        "unit": np.tile(space.units, steps),
        **{name: grid.T.ravel() for name, grid in grids.items()},
    }


@quietly
def nees(tally: Tally) -> Columns:
    """NEES over n, averaged over the runs at each time, with the band of a consistent filter.

    The band is that of a chi-square with the mean and variance of the law's mean over runs: exact if the law itself
    is a chi-square.
    """
    runs, lawful, n = tally.sums["nees_runs"], tally.sums["law_runs"], tally.space.size
    expected = _ratio(tally.sums["law_mean"], lawful * n)
    variance = _ratio(tally.sums["law_variance"], lawful * n**2) / _independent(tally, np.maximum(lawful, 1))
    lower, upper = chi_square_band(2.0 * expected**2 / variance)
    return {
        "time": tally.time,
        "anees": _ratio(tally.sums["nees"], runs * n),
        "expected": expected,
        "lower": expected * lower,
        "upper": expected * upper,
        "runs_scored": runs,
    }


@quietly
def nis(tally: Tally) -> Columns:
    """NIS over the number of values measured, at each time with a reading, with its 95 % band; 1 for a consistent
    filter.

    With a gate the expectation is less than 1, and the band lies about it.
    """
    measured = tally.sums["measured"] > 0
    size, runs = tally.sums["measured"][measured], tally.sums["nis_runs"][measured]
    lower, upper = chi_square_band(size * _independent(tally, runs) / np.maximum(runs, 1))
    expected = tally.sums["nis_mean"][measured] / size
    return {
        "time": tally.time[measured],
        "anis": tally.sums["nis"][measured] / size,
        "lower": expected * lower,
        "upper": expected * upper,
        "degrees_of_freedom": size,
        "runs_scored": runs,
    }


def notes(tally: Tally) -> Columns:
    """What a filter noted at each step, averaged over runs; only notes that occurred at least once."""
    prefix = "note_"
    found = {
        name.removeprefix(prefix): values / tally.runs
        for name, values in tally.sums.items()
        if name.startswith(prefix) and values.any()
    }
    count = tally.time.size
    return {
        "time": np.tile(tally.time, len(found)),
        "note": np.repeat(list(found), count) if found else np.empty(0),
        "mean": np.concatenate(list(found.values())) if found else np.empty(0),
    }


def _independent(tally: Tally, runs: Array) -> Array:
    """How many of the runs count for a band: repeats of one recording count as one."""
    return np.minimum(runs, 1) if tally.repeated else runs


def _stretch(tally: Tally) -> Array:
    """The factor by which each RMSE's interval reaches up and down, as in intervals.positive_interval."""
    from scipy.special import stdtrit

    count = np.where(tally.sums["scored"] > 1, tally.sums["scored"], np.nan)
    if tally.repeated:
        count = np.full(count.shape, np.nan)
    mean = tally.sums["square"] / count
    variance = np.maximum(tally.sums["quartic"] / count - mean**2, 0.0) * count / (count - 1)
    half = stdtrit(count - 1, 0.5 + CONFIDENCE / 2.0) * np.sqrt(variance / count) / np.where(mean > 0.0, mean, np.nan)
    return np.exp(0.5 * np.minimum(half, 50.0))


def _ratio(total: Array, count: Array) -> Array:
    return np.asarray(total / np.where(count > 0, count, np.nan))
