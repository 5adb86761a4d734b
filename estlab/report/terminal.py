"""The summary on the terminal: figures, tests, verdicts, ranking; then the path."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from estlab.metrics.consistency import NEES, NIS, Test
from estlab.metrics.digits import figure, interval, p_value, share
from estlab.metrics.intervals import Estimate
from estlab.metrics.paired import against_best
from estlab.metrics.tabulated import MetricRow
from estlab.metrics.tally import CAUSES
from estlab.metrics.vocabulary import (
    ALL,
    HOLM_INTERVAL,
    HOLM_P,
    INTERVAL,
    errors_beside,
    expected,
    heading,
    test_heading,
    with_unit,
    written,
    written_with_interval,
)
from estlab.report import grids
from estlab.report.components import chosen, selection
from estlab.report.console import print_line
from estlab.report.findings import Findings
from estlab.report.grids import Grid
from estlab.rundir import METRICS

_MEANS = {"anees": NEES, "anis": NIS}


def summary(
    title: str,
    findings: Mapping[str, Findings],
    compared: Sequence[Mapping[str, Any]],
    own: Mapping[str, Sequence[Any]],
) -> None:
    """Print the tables: a line a component for one filter, a line a filter for several; the problem's own."""
    print_line(title, style="bold")
    for grid in _of_one(*findings.values()) if len(findings) == 1 else _of_several(findings, compared):
        grids.show(grid)
    if len(findings) == 1:
        for line in _events(*findings.values()):
            print_line(line)
    if own:
        lines = zip(*own.values(), strict=True)
        cells = [[cell if isinstance(cell, str) else _cell(cell) for cell in line] for line in lines]
        grids.show(Grid("", list(own), cells))
    if note := _selected(findings):
        print_line(f"note: {note}")


def ending(findings: Mapping[str, Findings], remarks: Sequence[str], where: str) -> None:
    """Print the verdicts, the remarks and the path: whatever became of the tables."""
    for name, found in findings.items():
        if found.verdict:
            print_line(f"{name} is {found.verdict.sentence}", style="bold")
    for remark in remarks:
        print_line(f"note: {remark}")
    print_line(where)


def _of_one(found: Findings) -> Iterator[Grid]:
    if any(row.metric == "rmse" and row.value == row.value for row in found.rows):
        yield _components(found)
    if found.tests:
        yield _tests(found)


def _of_several(findings: Mapping[str, Findings], compared: Sequence[Mapping[str, Any]]) -> Iterator[Grid]:
    yield _filters(findings)
    if any(_why(found) for found in findings.values()):
        yield _converged(findings)
    if any(row["n"] for row in compared):
        yield _ranking(compared)


def _components(found: Findings) -> Grid:
    """A line a component, for one filter; of many components a few, with the position and all of them together."""
    listed = _listed([found])
    diverged = found.row("diverged")
    beside = errors_beside(bool(diverged and diverged.value), any(row.metric == "efficiency" for row in found.rows))
    lines = [
        [
            with_unit(row.component, row.unit),
            written("rmse", row.estimate),
            interval(row.estimate),
            *(_written(found, metric, row.component) for metric in beside),
        ]
        for row in found.rows
        if row.metric == "rmse" and row.component in listed
    ]
    return Grid("", ["", heading("rmse"), INTERVAL, *map(heading, beside)], lines)


def _names(findings: Collection[Findings]) -> tuple[list[str], list[int]]:
    """The names of the components, and the places of those that are chosen."""
    rows = [row for found in findings for row in found.rows]
    names = list(dict.fromkeys(row.component for row in rows if row.metric == "mean_sigma"))
    ratios = np.array([[_ratio(found, name) for name in names] for found in findings])
    return names, chosen(np.nan_to_num(ratios).max(axis=0, initial=0.0))


def _listed(findings: Collection[Findings]) -> list[str]:
    """What has a line or column of its RMSE: the components that are chosen, then the position and all together."""
    names, few = _names(findings)
    rmse = dict.fromkeys(row.component for found in findings for row in found.rows if row.metric == "rmse")
    return [*(names[i] for i in few), *(name for name in rmse if name not in names)]


def _selected(findings: Mapping[str, Findings]) -> str:
    names, few = _names(findings.values())
    note = selection(few, len(names))
    return f"{note}; {METRICS} has all" if note else ""


def _ratio(found: Findings, component: str) -> float:
    """RMSE over mean sigma; NaN where there is none."""
    error, sigma = found.row("rmse", component), found.row("mean_sigma", component)
    return error.value / sigma.value if error and sigma and sigma.value > 0.0 else float("nan")


def _tests(found: Findings) -> Grid:
    """A line a test."""
    lines = [
        [
            test_heading(test.name, test.of),
            figure(test.found, test.expected),
            interval(test.found, test.expected),
            expected(test.name, test.expected),
            test.why or _p_value(test),
        ]
        for test in found.tests
    ]
    return Grid("", ("is it consistent?", "found", HOLM_INTERVAL, "should be", HOLM_P), lines)


def _filters(findings: Mapping[str, Findings]) -> Grid:
    """A line a filter: RMSE of each component, consistency, what went wrong."""
    errors = _errors(findings)
    means = [(metric, ALL) for metric in _MEANS]
    extra = [("found", "position"), ("ess", ALL), ("efficiency", "position")]
    known = [metric for metric in (*means, *extra) if any(found.row(*metric) for found in findings.values())]
    divided = {metric: test_heading(test, _divisor(findings, test)) for metric, test in _MEANS.items()}
    headings = [heading("rmse", row.component, row.unit) for row in errors]
    headings += [*(divided.get(metric, heading(metric)) for metric, _ in known), heading("diverged")]
    lines = []
    for name, found in findings.items():
        cells = [_written(found, "rmse", row.component) for row in errors]
        cells += [_written(found, *metric) for metric in known]
        diverged = found.row("diverged")
        lines.append([name, *cells, written_with_interval("diverged", diverged.estimate) if diverged else ""])
    return Grid("", ["", *headings], lines)


def _divisor(findings: Mapping[str, Findings], name: str) -> str:
    """What a column's NEES or NIS is over: n or m, unless it is another of a filter."""
    found = dict.fromkeys(test.of for one in findings.values() for test in one.tests if test.name == name)
    return next(iter(found)) if len(found) == 1 else "expected"


def _errors(findings: Mapping[str, Findings]) -> list[MetricRow]:
    """The rows of RMSE of what is listed, of any filter, where some filter has one."""
    rows = {row.component: row for found in findings.values() for row in found.rows if row.metric == "rmse"}
    listed = _listed(findings.values())
    return [rows[name] for name in listed if any(found.row("rmse", name) for found in findings.values())]


def _converged(findings: Mapping[str, Findings]) -> Grid:
    """RMSE of the runs that neither broke nor were lost, and why the others did."""
    errors = _errors(findings)
    headings = ["converged runs alone", *(with_unit(row.component, row.unit) for row in errors), "the others"]
    lines = [
        [name, *(_written(found, "rmse_converged", row.component) for row in errors), _why(found)]
        for name, found in findings.items()
    ]
    return Grid("", headings, lines)


def _ranking(compared: Sequence[Mapping[str, Any]]) -> Grid:
    """Each filter against the best in position, in all together, or in the first component."""
    components = list(dict.fromkeys(row["component"] for row in compared))
    component = next((name for name in ("position", ALL) if name in components), components[0])
    lines = []
    for row in against_best(compared, component):
        line = [row["filter"], _cell(float(f"{row['rmse']:.4g}"))]
        if "difference" not in row:
            lines.append([*line, "the best", "", "", "", ""])
            continue
        difference = Estimate(row["difference"], row["ci_low"], row["ci_high"], row["n"])
        wins = f"{share(row['wins'])} of runs" if row["n"] > 1 else ""
        real = "" if row["p_holm"] != row["p_holm"] else "yes" if row["real"] else "no"
        line += [figure(difference, 0.0), interval(difference, 0.0), wins, real, f"{row['cost_ratio']:.2g} ×"]
        lines.append(line)
    headings = ("more than the best", HOLM_INTERVAL, "better in", "real?", "time to the best's")
    return Grid("", ["", f"{heading('rmse')} {component}", *headings], lines)


def _events(found: Findings) -> Iterator[str]:
    """What happened beside errors: found, resampled, gated, diverged."""
    if row := found.row("found", "position"):
        when = found.row("found_time", "position")
        since = f", from {written('found_time', when.estimate)} s on average" if when else ""
        yield f"{written('found', row.estimate)} of the runs found the position{since}"
    if ess := found.row("ess"):
        yield f"{heading('ess')} {written('ess', ess.estimate)} on average"
    if vanished := found.row("vanished"):
        yield f"all weights vanished at {written('vanished', vanished.estimate)} readings"
    if gated := found.row("gated"):
        yield f"{written('gated', gated.estimate)} readings gated"
    if diverged := found.row("diverged"):
        why = f": {_why(found)}" if diverged.value else ""
        yield f"{written_with_interval('diverged', diverged.estimate)} run{'s' * (diverged.n > 1)} diverged{why}"


def _why(found: Findings) -> str:
    rows = [found.row(cause) for cause in CAUSES]
    return ", ".join(f"{written(row.metric, row.estimate)} {heading(row.metric)}" for row in rows if row and row.value)


def _p_value(test: Test) -> str:
    if test.p != test.p:
        return "not available"
    return f"{p_value(test.adjusted)} ✗" if test.rejected else p_value(test.adjusted)


def _written(found: Findings, metric: str, component: str = ALL) -> str:
    row = found.row(metric, component)
    return written(metric, row.estimate) if row else ""


def _cell(value: float) -> str:
    return "" if value != value else f"{value:.10g}"
