"""The tables of a sweep: a row for each job and filter, each group of repeats, each failure."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import BinaryIO

import numpy as np

from estlab import rundir
from estlab.config.settings import NEITHER, RECORD, words_without
from estlab.metrics.intervals import mean_interval
from estlab.metrics.moments import SampleMoments
from estlab.report import csv_tables
from estlab.rundir import files
from estlab.rundir.layout import FAILURES, GROUPS, SWEEP
from estlab.sweeps import split, state
from estlab.sweeps.state import Outcome, Planned

SweepRow = dict[str, str]

VERDICT = "verdict"  # a metric with a word as its component


def write_all(sweep: Path, planned: Sequence[Planned], outcomes: Mapping[str, Outcome], repeats: int) -> None:
    """Write sweep.csv, failures.csv and, with repeats, groups.csv."""
    rows = job_rows(planned, outcomes)
    _write(sweep, SWEEP, rows)
    _write(sweep, FAILURES, failure_rows(sweep, planned, outcomes), ("job", "attempt", "status", "error", "directory"))
    if repeats > 1:
        _write(sweep, GROUPS, group_rows(rows, planned))


def draw_all(
    sweep: Path, planned: Sequence[Planned], outcomes: Mapping[str, Outcome], repeats: int, zipped: Sequence[str]
) -> list[str]:
    """Draw the plots from the tables. Returns messages about those that could not be drawn."""
    from estlab.report import sweep_plots

    drawn = sweep / (SWEEP if repeats == 1 else GROUPS)
    keys = [key for key in swept_keys(planned) if key != "seed" or repeats == 1]
    keys = [key for key in keys if key not in zipped[1:]]
    return sweep_plots.draw_all(drawn, _common(planned), keys, units(outcomes), partial(_save, sweep))


def swept_keys(planned: Sequence[Planned]) -> list[str]:
    """The keys with several values, except the filter, which always has a column."""
    return [key for key in dict.fromkeys(key for job in planned for key in job.values) if key != "filter"]


def _common(planned: Sequence[Planned]) -> str:
    """The words common to all jobs, except those that change no figure."""
    words = [word for word in planned[0].overrides if all(word in job.overrides for job in planned)]
    return " ".join(words_without(words, NEITHER, RECORD))


def job_rows(planned: Sequence[Planned], outcomes: Mapping[str, Outcome]) -> list[SweepRow]:
    """The rows of sweep.csv, with numbers as the jobs wrote them."""
    rows = []
    for job in planned:
        found = split.whole(job, outcomes)
        values = {key: job.values.get(key, "") for key in swept_keys(planned)}
        # A job that runs elsewhere or was cut off is not done; only this machine can tell which.
        word = {"running": "left", "interrupted": "left", "damaged": "failed"}.get(found.state, found.state)
        took = "" if found.wall_time is None or not found.whole else repr(found.wall_time)
        by_filter = dict.fromkeys(row["filter"] for row in found.rows) or {job.values.get("filter", ""): None}
        for filter in by_filter:
            rows.append(
                {"job": job.name, **values, "filter": filter, "status": word, "wall_time_s": took}
                | _metrics([row for row in found.rows if row["filter"] == filter])
            )
    return _squared(rows)


def _metrics(rows: Sequence[Mapping[str, str]]) -> SweepRow:
    """Rows of a metrics.csv as columns: rmse.x, rmse.x.low, rmse.x.high."""
    cells: SweepRow = {}
    for row in rows:
        if row["metric"].startswith(VERDICT):
            cells[row["metric"]] = row["component"]
            continue
        name = f"{row['metric']}.{row['component']}"
        cells |= {name: row["value"], f"{name}.low": row["ci_low"], f"{name}.high": row["ci_high"]}
    return cells


def _squared(rows: Sequence[SweepRow]) -> list[SweepRow]:
    """Every row with every column, except columns of intervals that are empty in all rows."""
    columns = dict.fromkeys(column for row in rows for column in row)
    kept = [c for c in columns if not c.endswith((".low", ".high")) or any(row.get(c) for row in rows)]
    return [{column: row.get(column, "") for column in kept} for row in rows]


def group_rows(rows: Sequence[SweepRow], planned: Sequence[Planned]) -> list[SweepRow]:
    """The mean of each metric over a group's repeats, with Student's 95 % interval over them."""
    keys = [*(key for key in swept_keys(planned) if key != "seed"), "filter"]
    fixed = {"job", "seed", "status", "wall_time_s", *keys}
    columns = [c for c in (rows[0] if rows else {}) if c not in fixed and not c.endswith((".low", ".high"))]
    columns = [column for column in columns if not column.startswith(VERDICT)]
    groups: dict[tuple[str, ...], list[SweepRow]] = {}
    for row in rows:
        groups.setdefault(tuple(row[key] for key in keys), []).append(row)
    found = []
    for values, members in groups.items():
        ok = [row for row in members if row["status"] in rundir.WHOLE]
        if not ok and any(other[:-1] == values[:-1] and other != values for other in groups):
            continue  # jobs that failed before they had a filter's name, beside others of their group
        cells = dict(zip(keys, values, strict=True)) | {"repeats": str(len(ok))}
        for column in columns:
            mean = mean_interval(SampleMoments.of(np.array([[float(row[column] or "nan") for row in ok]])))
            numbers = {column: mean.value, f"{column}.low": mean.low, f"{column}.high": mean.high}
            cells |= {name: "" if np.isnan(number) else repr(float(number)) for name, number in numbers.items()}
        found.append(cells)
    return _squared(found)


def failure_rows(sweep: Path, planned: Sequence[Planned], outcomes: Mapping[str, Outcome]) -> list[SweepRow]:
    """A row for each failed attempt at a job or part, including those that a later attempt made good."""
    rows = []
    for job in split.units(planned):
        earlier = state.attempts(sweep, job.name)
        tries = [(state.outcome(sweep, place, job.fingerprint), place) for place in earlier]
        for number, (found, place) in enumerate([*tries, (outcomes[job.name], job.name)], 1):
            if found.state in ("failed", "damaged") or (not found.whole and place in earlier):
                error = found.error or "ended without a result"
                rows.append(
                    {"job": job.name, "attempt": str(number), "status": found.state, "error": error, "directory": place}
                )
    return rows


def units(outcomes: Mapping[str, Outcome]) -> dict[str, str]:
    """The unit of each metric's column."""
    return {f"{r['metric']}.{r['component']}": r["unit"] or "" for found in outcomes.values() for r in found.rows}


def _write(sweep: Path, name: str, rows: Sequence[SweepRow], columns: Sequence[str] = ()) -> None:
    files.write(sweep, name, partial(csv_tables.write, rows or {column: [] for column in columns}))


def _save(sweep: Path, name: str, write: Callable[[BinaryIO], object]) -> Path:
    return files.write(sweep, f"{rundir.PLOTS}/{name}", write)
