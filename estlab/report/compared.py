"""The tables of a comparison of runs: the metrics of each row, and the differences from one of them."""

from collections.abc import Mapping, Sequence
from typing import Any, BinaryIO

from estlab.comparison.pairing import Pair
from estlab.comparison.rows import ComparisonRow
from estlab.errors import printable
from estlab.metrics.digits import figure, interval, p_value, share
from estlab.metrics.vocabulary import (
    ALL,
    DIVERGED,
    HOLM_INTERVAL,
    HOLM_P,
    Metric,
    column,
    heading,
    with_unit,
    written_with_interval,
)
from estlab.report import csv_tables
from estlab.report.grids import Grid

VERDICT: Metric = ("verdict", ALL)


def metrics_grid(rows: Sequence[ComparisonRow], metrics: Sequence[Metric]) -> Grid:
    """A line a row: its number, label and metrics with their intervals; those that no row has are left out."""
    units = {metric: {row.metrics[metric].unit for row in rows if metric in row.metrics} for metric in metrics}
    headings = ["", "", *(_heading(metric, units[metric]) for metric in metrics)]
    lines = [
        [str(number), row.label, *(_cell(row, metric, len(units[metric]) > 1) for metric in metrics)]
        for number, row in enumerate(rows, 1)
    ]
    filled = [i for i in range(len(headings)) if i < 2 or any(line[i] for line in lines)]
    return Grid(_title(rows), [headings[i] for i in filled], [[line[i] for i in filled] for line in lines], 2)


def differences_grid(
    rows: Sequence[ComparisonRow], against: int, pairs: Mapping[str, Pair], components: Sequence[str]
) -> Grid | None:
    """A line a row and component that is paired with the one it is held against; None if none is.

    against: the number of that row, from 1.
    """
    lines = []
    for number, row in enumerate(rows, 1):
        pair = pairs.get(row.label)
        for component in components if pair else ():
            one = pair.differences.get(component) if pair else None
            if one and one.found.value == one.found.value:
                unit = row.metrics["rmse", component].unit
                wins = f"{share(one.wins)} of {one.found.n}" if one.found.n else ""
                cells = (figure(one.found, 0.0), interval(one.found, 0.0), p_value(one.p_holm), wins)
                lines.append([str(number), row.label, with_unit(component, unit), *cells])
    title = f"RMSE minus that of row {against}, {rows[against - 1].label}, on the same truth and readings"
    headings = ["", "", "component", "difference", HOLM_INTERVAL, HOLM_P, "better in, of runs"]
    return Grid(title, headings, lines, 3) if lines else None


def not_paired(rows: Sequence[ComparisonRow], against: int, pairs: Mapping[str, Pair]) -> list[str]:
    """Which rows are not compared with the one, and why: a line a reason."""
    reasons: dict[str, list[int]] = {}
    for number, row in enumerate(rows, 1):
        if (pair := pairs.get(row.label)) and pair.why_not:
            reasons.setdefault(pair.why_not, []).append(number)
    return [
        f"row{'s' * (len(numbers) > 1)} {', '.join(map(str, numbers))} not paired with row {against}: {why}"
        for why, numbers in reasons.items()
    ]


def lines(
    rows: Sequence[ComparisonRow],
    metrics: Sequence[Metric],
    against: int,
    pairs: Mapping[str, Pair],
    components: Sequence[str],
) -> list[dict[str, Any]]:
    """The comparison as a table: a line a row, by column."""
    found = []
    for number, row in enumerate(rows, 1):
        line: dict[str, Any] = {"row": number, "label": row.label, "directory": str(row.run.path)}
        line |= {"scenario": row.run.scenario, "filter": row.filter, "seed": row.settings.get("seed")}
        for metric in metrics:
            line |= _numbers(row, metric)
        pair = pairs.get(row.label)
        line |= {"against": against if pair else None, "not_paired": pair.why_not if pair else ""}
        for component in components:
            one = pair.differences.get(component) if pair else None
            name = f"difference.{component}"
            line |= {
                name: one.found.value if one else None,
                f"{name}.low": one.found.low if one else None,
                f"{name}.high": one.found.high if one else None,
                f"{name}.p_holm": one.p_holm if one else None,
                f"{name}.wins": one.wins if one else None,
                f"{name}.n": one.found.n if one else None,
            }
        found.append(line)
    return found


def write(table: Sequence[Mapping[str, Any]], stream: BinaryIO) -> None:
    """Write the lines of a comparison as CSV, numbers in full."""
    csv_tables.write([{_harmless(name): _harmless(cell) for name, cell in line.items()} for line in table], stream)


def _numbers(row: ComparisonRow, metric: Metric) -> dict[str, Any]:
    name = column(*metric)
    if metric == VERDICT:
        return {"verdict": row.verdict}
    one = row.metrics.get(metric)
    if metric[0] in DIVERGED:
        return {name: one.found.value if one else None, f"{name}.of": one.found.n if one else None}
    return {
        name: one.found.value if one else None,
        f"{name}.low": one.found.low if one else None,
        f"{name}.high": one.found.high if one else None,
        f"{name}.unit": one.unit if one else None,
    }


def _harmless(cell: Any) -> Any:
    """A text without what would steer a terminal, and as text where a spreadsheet would take it for a formula."""
    if not isinstance(cell, str):
        return cell
    return f"'{printable(cell)}" if cell.startswith(("=", "+", "-", "@", "\t", "\r")) else printable(cell)


def _title(rows: Sequence[ComparisonRow]) -> str:
    scenarios = ", ".join(dict.fromkeys(row.run.scenario for row in rows))
    runs = len({row.run.path for row in rows})
    return f"{scenarios} · {runs} run director{'ies' if runs > 1 else 'y'}"


def _heading(metric: Metric, units: set[str]) -> str:
    return heading(*metric, next(iter(units)) if len(units) == 1 else "")


def _cell(row: ComparisonRow, metric: Metric, with_unit: bool) -> str:
    if metric == VERDICT:
        return row.verdict
    one = row.metrics.get(metric)
    cell = written_with_interval(metric[0], one.found) if one else ""
    return f"{cell} {one.unit}" if one and cell and with_unit else cell
