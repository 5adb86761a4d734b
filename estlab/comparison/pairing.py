"""Filters of separate runs, compared run by run where both met the same truth and readings."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from estlab import rundir
from estlab.comparison.rows import ComparisonRow, same, short
from estlab.errors import UserError
from estlab.maths.space import Array, Space
from estlab.metrics.intervals import Estimate, holm, judged_at, widened
from estlab.metrics.paired import Comparison
from estlab.rundir.finished import Finished, table

if TYPE_CHECKING:
    from pandas import DataFrame

_MARKS = ("truth_mark", "readings_mark")
_SAME = 1e-9  # marks differ by less if other hardware rounded the same truth differently

# What determines truth and readings.
_GROUPS = ("scenario", "data", "steps", "seed")


@dataclass(frozen=True)
class Difference:
    """RMSE of a row minus that of the reference row, over the runs of both, and how often it is smaller."""

    rmse: float
    found: Estimate
    p: float
    p_holm: float
    wins: float


@dataclass(frozen=True)
class Pair:
    """A row against another: the differences by component, or why there are none."""

    why_not: str
    differences: Mapping[str, Difference]


def pairs(
    rows: Sequence[ComparisonRow], against: ComparisonRow, components: Sequence[str]
) -> tuple[dict[str, Pair], list[str]]:
    """Each other row by its label, compared with one, and remarks about what could not be read.

    p-values are adjusted for the number of rows (Holm), and intervals match their tests.
    """
    tables, unread = {}, []
    for path, run in {row.run.path: row.run for row in rows}.items():
        try:
            tables[path] = _each_run(run)
        except UserError as error:
            unread.append(str(error))
    found = {row.label: _pair(row, against, components, tables) for row in rows if row is not against}
    for component in components:
        tested = [label for label, pair in found.items() if component in pair.differences]
        p_values = np.array([found[label].differences[component].p for label in tested])
        for label, fair, level in zip(tested, holm(p_values), judged_at(p_values), strict=True):
            one = found[label]
            difference = one.differences[component].found
            as_judged = widened(difference, level) if np.isfinite(level) else difference
            fairer = {component: replace(one.differences[component], p_holm=float(fair), found=as_judged)}
            found[label] = replace(one, differences={**one.differences, **fairer})
    return found, unread


def what_differs(a: ComparisonRow, b: ComparisonRow) -> list[str]:
    """What determines truth and readings and differs between the two, in words."""
    found = []
    if a.run.scenario != b.run.scenario:
        found.append(f"scenario {a.run.scenario} and {b.run.scenario}")
    else:
        for key in dict.fromkeys([*a.settings, *b.settings]):
            values = (a.settings.get(key), b.settings.get(key))
            if _decides(key) and not same(*values):
                found.append(f"{key} {short(values[0])} and {short(values[1])}")
    if _data(a) != _data(b):
        found.append("data files")
    return found


def _decides(key: str) -> bool:
    return key.partition(".")[0] in _GROUPS or key.startswith("noise.truth.")


def _each_run(run: Finished) -> "DataFrame":
    """The lines of runs.csv, by filter and run number, each once."""
    found = table(run.path, rundir.RUNS, ("filter",))
    if not {"run", *_MARKS} <= set(found.columns):
        raise UserError(f"{run.path / rundir.RUNS}: lacks one of the columns run, {', '.join(_MARKS)}")
    return found.drop_duplicates(["filter", "run"]).set_index(["filter", "run"])


def _pair(
    row: ComparisonRow, against: ComparisonRow, components: Sequence[str], tables: "Mapping[Path, DataFrame]"
) -> Pair:
    for one in (row, against):
        if one.run.path not in tables or one.filter not in tables[one.run.path].index.get_level_values("filter"):
            return Pair(f"no {rundir.RUNS} for {one.label}", {})
    mine, theirs = (tables[one.run.path].loc[one.filter] for one in (row, against))
    both = mine.index.intersection(theirs.index)
    if both.empty:
        return Pair("no run number in common", {})
    mine, theirs = mine.loc[both], theirs.loc[both]
    marks = mine[[*_MARKS]].to_numpy(dtype=float)
    met_the_same = np.allclose(marks, theirs[[*_MARKS]].to_numpy(dtype=float), rtol=_SAME, atol=0.0)
    if not met_the_same or _data(row) != _data(against):
        differs = what_differs(row, against) or [f"configurations agree, {_versions(row)} and {_versions(against)}"]
        return Pair(f"truth or readings differ: {', '.join(differs)}", {})
    shared = {
        name: row.metrics["rmse", name].unit
        for name in components
        if all(("rmse", name) in one.metrics for one in (row, against))
        and all(f"rmse.{name}" in one.columns for one in (mine, theirs))
    }
    if not shared:
        return Pair("no component in common", {})
    if any(against.metrics["rmse", name].unit != unit for name, unit in shared.items()):
        return Pair("units differ", {})
    squares = [one[[f"rmse.{name}" for name in shared]].to_numpy(dtype=float).T ** 2 for one in (mine, theirs)]
    repeated = len(both) > 1 and bool(np.ptp(marks, axis=0).max() == 0.0)
    return Pair("", _differences(shared, squares, repeated))


def _differences(units: Mapping[str, str], squares: Sequence[Array], repeated: bool) -> dict[str, Difference]:
    """By component, from the mean squares (components, runs) of the two."""
    comparison = Comparison(Space(tuple(units), tuple(units.values())), repeated)
    # In alphabetical order, as it expects them.
    comparison.add({"a": {"mean_square": squares[0]}, "b": {"mean_square": squares[1]}})
    found = {}
    for line in comparison.rows({}):
        difference = Estimate(line["difference"], line["ci_low"], line["ci_high"], line["n"])
        found[line["component"]] = Difference(line["rmse"], difference, line["p"], line["p"], line["wins"])
    return found


def _data(row: ComparisonRow) -> list[str]:
    return sorted(row.run.data.values())


def _versions(row: ComparisonRow) -> str:
    packages = row.run.facts.get("packages")
    numpy = packages.get("numpy") if isinstance(packages, Mapping) else None
    return f"estlab {row.run.facts.get('estlab')} with numpy {numpy}"
