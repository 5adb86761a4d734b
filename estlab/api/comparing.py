"""Runs side by side: which rows, which metrics, against which row; and the result as a table."""

import warnings
from collections.abc import Callable, Sequence
from os import PathLike, fspath
from pathlib import Path
from typing import TYPE_CHECKING

from estlab.comparison.differences import mismatches
from estlab.comparison.pairing import pairs
from estlab.comparison.rows import ComparisonRow, labelled, rows_of
from estlab.config.build import nearest
from estlab.errors import UserError
from estlab.metrics.vocabulary import Metric, usual
from estlab.report.compared import VERDICT, lines
from estlab.rundir import finished
from estlab.rundir.search import run_directories

if TYPE_CHECKING:
    from pandas import DataFrame


def compare(*paths: str | PathLike[str], metrics: Sequence[str] = (), against: int | str = 1) -> "DataFrame":
    """Runs side by side, as in ``estlab compare``: a row for each filter of each run.

    paths: run directories, folders of run directories, or patterns.
    metrics: "rmse.position", or "rmse" for all components; by default the errors, NEES, NIS and verdicts.
    against: the row to compare the others with, by its number from 1, its label, filter or directory. Where two
    met the same truth and readings, difference.<component> is the difference of their RMSE taken run by run, with its
    interval and Holm's p-value; else not_paired says why not.

    Differences that make rows not comparable, and runs that are left out, are warnings.

    Raises UserError if there is no run, and for an unknown metric or row.

    >>> import estlab
    >>> table = estlab.compare(folder, metrics=["rmse.position", "anees"])
    >>> table[["row", "label", "scenario", "filter"]]
       row label  scenario filter
    0    1   ekf  landmark    ekf
    >>> table["rmse.position"].between(0.01, 1.0).tolist()
    [True]
    """
    import pandas as pd

    rows, left_out = comparable_rows(run_directories([fspath(path) for path in paths]))
    if not rows:
        raise UserError("; ".join(left_out) or "no run can be compared")
    chosen = chosen_metrics(rows, metrics)
    components = [component for name, component in chosen if name == "rmse"]
    number = number_of(rows, str(against))
    paired, unread = pairs(rows, rows[number - 1], components) if components and len(rows) > 1 else ({}, [])
    for line in (*left_out, *mismatches(rows, chosen), *unread):
        warnings.warn(line, UserWarning, stacklevel=2)
    return pd.DataFrame(lines(rows, chosen, number, paired, components))


def comparable_rows(paths: Sequence[Path]) -> tuple[list[ComparisonRow], list[str]]:
    """The rows of all complete runs, and a line for each of the others."""
    rows, left_out = [], []
    for path in paths:
        try:
            if why := finished.unfinished(finished.status(path)):
                left_out.append(f"{path}: left out, {why}")
            else:
                rows += rows_of(finished.read(path))
        except UserError as error:
            left_out.append(str(error))
    return labelled(rows), left_out


def chosen_metrics(rows: Sequence[ComparisonRow], names: Sequence[str]) -> list[Metric]:
    """The columns: those named; otherwise errors of the position, of all jointly or of each component, and verdicts."""
    known = list(dict.fromkeys([*(metric for row in rows for metric in row.metrics), VERDICT]))
    if not names:
        errors = dict.fromkeys(metric for row in rows for metric in usual(row.metrics) if metric[0] == "rmse")
        return [*errors, *(metric for metric in usual(known) if metric[0] != "rmse")]
    chosen: list[Metric] = []
    for name in names:
        found = [metric for metric in known if name in (metric[0], ".".join(metric))]
        if not found:
            near = nearest(name, [".".join(metric) for metric in known])
            raise UserError(f"--metric {name}: no run has it{near or '; their metrics.csv lists what there is'}")
        chosen += found
    return list(dict.fromkeys(chosen))


def number_of(rows: Sequence[ComparisonRow], wanted: str) -> int:
    """The number of the requested row."""
    if wanted.isdecimal() and 1 <= int(wanted) <= len(rows):
        return int(wanted)
    place = Path(wanted).resolve()
    matching: Sequence[Callable[[ComparisonRow], bool]] = (
        lambda row: row.label == wanted,
        lambda row: row.filter == wanted,
        lambda row: place in (row.run.path.resolve(), Path(row.run.path.name)),
    )
    for matches in matching:
        found = [number for number, row in enumerate(rows, 1) if matches(row)]
        if len(found) == 1:
            return found[0]
        if found:
            raise UserError(f"--against {wanted}: matches rows {', '.join(map(str, found))}; give the number of one")
    raise UserError(f"--against {wanted}: no such row; give a number from 1 to {len(rows)}")
