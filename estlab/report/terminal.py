"""The summary that a person sees: figures, tests, verdicts, who is better; then the path."""

from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table
from rich.text import Text

from estlab.metrics.consistency import BIAS, INSIDE, LEAST_INSIDE, NEES, NIS, WHITENESS, Test
from estlab.metrics.digits import figure, interval
from estlab.metrics.intervals import Estimate
from estlab.metrics.paired import against_best
from estlab.metrics.tabulated import MetricRow
from estlab.metrics.tally import CAUSES
from estlab.report.components import chosen, selection
from estlab.report.console import console
from estlab.report.findings import Findings
from estlab.rundir import METRICS

_TESTS = {
    NEES: "NEES / {}",
    NIS: "NIS / {}",
    BIAS: "bias {} [sigma]",
    WHITENESS: "correlation of innovations, {}",
    INSIDE: "share of {} inside 3 sigma",
}
_MEANS = {"anees": NEES, "anis": NIS}


def summary(
    title: str,
    findings: Mapping[str, Findings],
    compared: Sequence[Mapping[str, Any]],
    own: Mapping[str, Sequence[Any]],
) -> None:
    """Print the tables: a line a component for one filter, a line a filter for several; the problem's own."""
    out = console()
    out.print(Text(title, style="bold"), soft_wrap=True)
    if len(findings) == 1:
        (only,) = findings.values()
        if any(row.metric == "rmse" and row.value == row.value for row in only.rows):
            out.print(_components(only))
        if only.tests:
            out.print(_tests(only))
        _print_events(out, only)
    else:
        out.print(_filters(findings))
        if any(_why(found) for found in findings.values()):
            out.print(_converged(findings))
        if any(row["n"] for row in compared):
            out.print(_ranking(compared))
    if own:
        table = _table(list(own))
        for cells in zip(*own.values(), strict=True):
            table.add_row(*(cell if isinstance(cell, str) else _cell(cell) for cell in cells))
        out.print(table)
    if said := _selected(findings):
        out.print(Text(f"note: {said}"), soft_wrap=True)


def ending(findings: Mapping[str, Findings], remarks: Sequence[str], where: str) -> None:
    """Print the verdicts, the remarks and the path: whatever became of the tables."""
    out = console()
    for name, found in findings.items():
        if found.verdict:
            out.print(Text(f"{name} is {found.verdict.sentence}", style="bold"), soft_wrap=True)
    for remark in remarks:
        out.print(Text(f"note: {remark}"), soft_wrap=True)
    out.print(Text(where), soft_wrap=True)


def _components(found: Findings) -> Table:
    """A line a component, for one filter; of many components a few, with the position and all of them together."""
    shown = _shown([found])
    bounded = any(row.metric == "efficiency" for row in found.rows)
    diverged = found.row("diverged")
    converged = bool(diverged and diverged.value)
    columns = ["", "RMSE", "95 % interval", *(["of converged"] if converged else [])]
    columns += [*(["bound / RMSE"] if bounded else []), "median |error|", "mean sigma", "inside 3 sigma", "time scored"]
    table = _table(columns)
    for row in found.rows:
        if row.metric == "rmse" and row.component in shown:
            name = row.component
            cells = [_figure(found.row("rmse_converged", name))] if converged else []
            cells += [_figure(found.row("efficiency", name))] if bounded else []
            cells += [_figure(found.row(metric, name)) for metric in ("median_abs_error", "mean_sigma")]
            cells += [_share(found.row(metric, name)) for metric in ("inside_3sigma", "scored")]
            table.add_row(Text(_named(name, row.unit)), _figure(_or_none(row)), _interval(row), *cells)
    return table


def _names(findings: Collection[Findings]) -> tuple[list[str], list[int]]:
    """The names of the components, and the places of those that are shown."""
    rows = [row for found in findings for row in found.rows]
    names = list(dict.fromkeys(row.component for row in rows if row.metric == "mean_sigma"))
    ratios = np.array([[_ratio(found, name) for name in names] for found in findings])
    return names, chosen(np.nan_to_num(ratios).max(axis=0, initial=0.0))


def _shown(findings: Collection[Findings]) -> list[str]:
    """What has a line or column of its RMSE: the components that are shown, then the position and all together."""
    names, few = _names(findings)
    rmse = dict.fromkeys(row.component for found in findings for row in found.rows if row.metric == "rmse")
    return [*(names[i] for i in few), *(name for name in rmse if name not in names)]


def _selected(findings: Mapping[str, Findings]) -> str:
    names, few = _names(findings.values())
    said = selection(few, len(names))
    return f"{said}; {METRICS} has all" if said else ""


def _ratio(found: Findings, component: str) -> float:
    """RMSE over mean sigma; NaN where there is none."""
    error, sigma = found.row("rmse", component), found.row("mean_sigma", component)
    return error.value / sigma.value if error and sigma and sigma.value > 0.0 else float("nan")


def _tests(found: Findings) -> Table:
    """A line a test."""
    table = _table(("is it consistent?", "found", "interval, Holm", "should be", "p, Holm"))
    for test in found.tests:
        expected = f"{LEAST_INSIDE:.3f} or more" if test.name == INSIDE else f"{test.expected:.0f}"
        table.add_row(
            Text(_TESTS[test.name].format(test.of)),
            figure(test.found, test.expected),
            interval(test.found, test.expected),
            expected,
            test.why or _p_value(test),
        )
    return table


def _filters(findings: Mapping[str, Findings]) -> Table:
    """A line a filter: RMSE of each component, consistency, what went wrong."""
    errors = _errors(findings)
    extra = [
        (metric, component)
        for metric, component in (("found", "position"), ("ess", "all"), ("efficiency", "position"))
        if any(found.row(metric, component) for found in findings.values())
    ]
    heads = {"found": "found", "ess": "ess", "efficiency": "bound / RMSE"}
    names = ["RMSE " + _named(row.component, row.unit) for row in errors]
    consistent = {metric: f"{test.upper()} / {_divisor(findings, test)}" for metric, test in _MEANS.items()}
    consistent = {metric: head for metric, head in consistent.items() if any(f.row(metric) for f in findings.values())}
    table = _table(("", *names, *consistent.values(), *(heads[metric] for metric, _ in extra), "diverged"))
    for name, found in findings.items():
        cells = [_figure(found.row("rmse", row.component)) for row in errors]
        cells += [_figure(found.row(metric)) for metric in consistent]
        cells += [_figure(found.row(metric, component)) for metric, component in extra]
        lost = found.row("diverged")
        table.add_row(Text(name), *cells, f"{lost.value:.0f} of {lost.n}" if lost else "")
    return table


def _divisor(findings: Mapping[str, Findings], name: str) -> str:
    """What a column's NEES or NIS is over: n or m, unless it is another of a filter."""
    found = dict.fromkeys(test.of for one in findings.values() for test in one.tests if test.name == name)
    return next(iter(found)) if len(found) == 1 else "expected"


def _errors(findings: Mapping[str, Findings]) -> list[MetricRow]:
    """The rows of RMSE of what is shown, of any filter, where some filter has one."""
    shown = _shown(findings.values())
    rows = {row.component: row for found in findings.values() for row in found.rows if row.metric == "rmse"}
    known = [name for name in shown if any(found.row("rmse", name) for found in findings.values())]
    return [rows[name] for name in known]


def _converged(findings: Mapping[str, Findings]) -> Table:
    """RMSE of the runs that neither broke nor were lost, and why the others did."""
    errors = _errors(findings)
    table = _table(("converged runs alone", *(_named(row.component, row.unit) for row in errors), "the others"))
    for name, found in findings.items():
        cells = [_figure(found.row("rmse_converged", row.component)) for row in errors]
        table.add_row(Text(name), *cells, _why(found))
    return table


def _ranking(compared: Sequence[Mapping[str, Any]]) -> Table:
    """Each filter against the best in position, in all together, or in the first component."""
    components = list(dict.fromkeys(row["component"] for row in compared))
    component = next((name for name in ("position", "all") if name in components), components[0])
    rows = against_best(compared, component)
    heads = (f"RMSE {component}", "more than the best", "interval, Holm", "better in", "real?", "time to the best's")
    table = _table(("", *heads))
    for row in rows:
        if "difference" not in row:
            table.add_row(Text(row["filter"]), _cell(float(f"{row['rmse']:.4g}")), "the best", "", "", "", "")
            continue
        difference = Estimate(row["difference"], row["ci_low"], row["ci_high"], row["n"])
        real = "" if row["p_holm"] != row["p_holm"] else "yes" if row["real"] else "no"
        table.add_row(
            Text(row["filter"]),
            _cell(float(f"{row['rmse']:.4g}")),
            figure(difference, 0.0),
            interval(difference, 0.0),
            f"{100.0 * row['wins']:.0f} % of runs" if row["n"] > 1 else "",
            real,
            f"{row['cost_ratio']:.2g} ×",
        )
    return table


def _table(headings: Sequence[str]) -> Table:
    table = Table(box=None, pad_edge=False)
    for i, heading in enumerate(headings):
        table.add_column(Text(heading), justify="left" if i == 0 else "right")
    return table


def _print_events(out: Console, found: Findings) -> None:
    """What happened beside errors: found, resampled, gated, diverged."""
    if share := found.row("found", "position"):
        when = found.row("found_time", "position")
        since = f", from {_figure(when)} s on in the mean" if when else ""
        out.print(f"{_share(share)} of the runs found the position{since}")
    if ess := found.row("ess"):
        out.print(f"effective sample size {_figure(ess)} in the mean")
    if vanished := found.row("vanished"):
        out.print(f"all weights vanished at {vanished.value:.0f} readings")
    if gated := found.row("gated"):
        out.print(f"{gated.value:.0f} readings gated")
    if diverged := found.row("diverged"):
        why = f": {_why(found)}" if diverged.value else ""
        out.print(f"{diverged.value:.0f} of {diverged.n} run{'s' * (diverged.n > 1)} diverged{why}")


def _why(found: Findings) -> str:
    rows = [found.row(cause) for cause in CAUSES]
    return ", ".join(f"{row.value:.0f} {row.metric.replace('_', ' ')}" for row in rows if row and row.value)


def _p_value(test: Test) -> str:
    if test.p != test.p:
        return "not available"
    said = "< 0.0001" if test.adjusted < 1e-4 else f"{test.adjusted:.2g}"
    return f"{said} ✗" if test.rejected else said


def _named(component: str, unit: str) -> str:
    return f"{component} [{unit}]" if unit else component


def _cell(value: float) -> str:
    return "" if value != value else f"{value:.10g}"


def _or_none(row: MetricRow) -> MetricRow | None:
    return None if row.value != row.value else row


def _figure(row: MetricRow | None) -> str:
    return "" if row is None else figure(_estimate(row))


def _interval(row: MetricRow) -> str:
    return interval(_estimate(row))


def _estimate(row: MetricRow) -> Estimate:
    return Estimate(row.value, row.ci_low, row.ci_high, row.n)


def _share(row: MetricRow | None) -> str:
    return "" if row is None else f"{100.0 * row.value:.1f} %"
