"""The name, unit, format and meaning of each metric, stated only here."""

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Literal

from estlab.metrics.digits import bracketed, figure, share, share_interval
from estlab.metrics.intervals import Estimate

Metric = tuple[str, str]  # its name and its component, as in metrics.csv
Form = Literal["figure", "share", "count"]

ALL = "all"  # the component of a metric without components
INTERVAL, HOLM_INTERVAL, HOLM_P = "95 % interval", "interval, Holm", "p, Holm"
CONSISTENT_BAND = "95 % of a consistent filter"


@dataclass(frozen=True)
class Term:
    """A metric. unit: None for that of the component.

    form: a figure with the digits that its interval justifies, a share in per cent, or an integer count.
    """

    heading: str
    meaning: str
    unit: str | None = ""
    form: Form = "figure"


METRICS = {
    "rmse": Term("RMSE", "root mean square error over runs and time", None),
    "rmse_converged": Term("RMSE, converged", "the same over the runs that neither broke nor were lost", None),
    "median_abs_error": Term("median |error|", "median over time of the absolute error, mean over runs", None),
    "mean_error": Term("mean error", "mean error over time and runs", None),
    "mean_sigma": Term("mean sigma", "mean over time and runs of the standard deviation that the filter states", None),
    "inside_3sigma": Term("inside 3 sigma", "share of the time with the error in 3 sigma", form="share"),
    "scored": Term("time scored", "share of the time for which there is an error", form="share"),
    "normalised_bias": Term("bias", "mean of the error over its stated standard deviation, 0 if consistent", "sigma"),
    "anees": Term("NEES / n", "normalised estimation error squared over its expectation, 1 if consistent"),
    "anees_converged": Term("NEES / n, converged", "the same over the runs that neither broke nor were lost"),
    "anis": Term("NIS / m", "normalised innovation squared over its expectation, 1 if consistent"),
    "innovation_correlation": Term("correlation of innovations", "of whitened innovations, 0 if consistent"),
    "noncredibility": Term("noncredibility", "distance of covariance and mean square error, near 0 if credible", "dB"),
    "inclination": Term("inclination", "the same with a sign: above 0 overconfident, below 0 conservative", "dB"),
    "loglik": Term("log-likelihood", "log-likelihood of the innovations per value measured", "nat"),
    "efficiency": Term("bound / RMSE", "Cramér-Rao bound over RMSE, at most 1, apart from chance"),
    "found": Term("found", "share of the runs that found the position", form="share"),
    "found_time": Term("time to find", "mean time from which the position is found", "s"),
    "ess": Term("effective sample size", "mean over the steps with readings and over runs", "particles"),
    "gated": Term("gated", "readings that the gate rejected", "readings", "count"),
    "vanished": Term("vanished", "readings at which all weights vanished", "readings", "count"),
    "not_finite": Term("not finite", "runs whose estimate became infinite or NaN", "runs", "count"),
    "not_definite": Term("not definite", "runs whose covariance lost its definiteness", "runs", "count"),
    "lost": Term("lost", "runs whose position error stayed beyond the lost radius to the end", "runs", "count"),
    "diverged": Term("diverged", "runs that broke or were lost", "runs", "count"),
    "verdict": Term("verdict", "the filter's verdict; its value is the smallest p-value of the tests", "p"),
}
DIVERGED = ("not_finite", "not_definite", "lost", "diverged")  # counts of runs, out of so many

TESTS = {
    "nees": "NEES / {}",
    "nis": "NIS / {}",
    "bias": "bias {} [sigma]",
    "whiteness": "correlation of innovations, {}",
    "inside_3sigma": "share of {} inside 3 sigma",
}


def term(name: str) -> Term:
    """The metric of a name; an unknown one, from a plugin or another version, keeps its name."""
    return METRICS.get(name) or Term(name.replace("_", " "), "")


def unit_of(name: str, component_unit: str = "") -> str:
    """The unit of a metric for a component with this unit."""
    unit = term(name).unit
    return component_unit if unit is None else unit


def heading(name: str, component: str = ALL, unit: str = "") -> str:
    """A column's heading or an axis' label: 'RMSE x [m]'. A count has no unit."""
    one = term(name)
    named = one.heading if component == ALL else f"{one.heading} {component}"
    return named if one.form == "count" else with_unit(named, unit)


def with_unit(name: str, unit: str) -> str:
    """'x [m]'."""
    return f"{name} [{unit}]" if unit else name


def column(name: str, component: str = ALL) -> str:
    """A metric in one word, as --metric takes it: rmse.x, anees."""
    return name if component == ALL else f"{name}.{component}"


def written(name: str, found: Estimate) -> str:
    """A value as in every table; empty for NaN."""
    form = term(name).form
    if math.isnan(found.value):
        return ""
    if form == "count":
        return f"{found.value:.0f}"
    return share(found.value) if form == "share" else figure(found)


def written_with_interval(name: str, found: Estimate) -> str:
    """The same with its interval, or with the number of runs: '0.997 [0.944, 1.052]', '2 of 100'."""
    if math.isnan(found.value):
        return ""
    if name in DIVERGED:
        return f"{found.value:.0f} of {found.n}"
    if term(name).form == "share" and not math.isnan(found.low):
        return f"{share(found.value)} [{share_interval(found.low, found.high).replace(' to ', ', ')}]"
    return bracketed(found) if term(name).form == "figure" else written(name, found)


def test_heading(test: str, of: str) -> str:
    """A test and its subject: 'NEES / n'."""
    return TESTS.get(test, test).replace("{}", of)


def expected(test: str, value: float) -> str:
    """The expected value of a test; the minimum if more is as good."""
    if math.isnan(value):
        return ""
    return f"{value:.3f} or more" if test == "inside_3sigma" else f"{value:.3g}"


def errors_beside(diverged: bool, bounded: bool) -> list[str]:
    """The metrics beside each RMSE in a table of errors, if runs diverged and if there is a bound."""
    more = ["rmse_converged"] * diverged + ["efficiency"] * bounded
    return [*more, "median_abs_error", "mean_sigma", "inside_3sigma", "scored"]


def usual(known: Collection[Metric], most: int | None = None) -> list[Metric]:
    """The few metrics that fit in a table of runs: errors, consistency, divergence, verdict, as far as known.

    Errors are those of the position, otherwise of all components jointly, otherwise of each component, ``most`` at
    most.
    """
    errors = [metric for metric in known if metric[0] == "rmse"]
    whole: Sequence[Metric] = [one for one in (("rmse", "position"), ("rmse", ALL)) if one in errors]
    others: Sequence[Metric] = [("anees", ALL), ("anis", ALL), ("diverged", ALL), ("verdict", ALL)]
    return [*(whole[:1] or errors[:most]), *(metric for metric in others if metric in known)]


def usual_columns(columns: Sequence[str], most: int | None = None) -> list[str]:
    """The same for a sweep's table, by its columns: rmse.position, anees.all."""
    ends = (".low", ".high")
    known = {split_column(one): one for one in columns if not one.endswith(ends) and split_column(one)[0] in METRICS}
    return [known[metric] for metric in usual(known, most)]


def split_column(column: str) -> Metric:
    """The metric of a sweep's column; a verdict's has no component."""
    name, _, component = column.partition(".")
    return name, component or ALL


def column_heading(column: str, unit: str = "") -> str:
    """The heading of a sweep's column."""
    return heading(*split_column(column), unit)
