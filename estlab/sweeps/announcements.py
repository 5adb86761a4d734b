"""What a sweep prints before and after its jobs."""

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

from estlab.launch.arguments import OF_A_SWEEP
from estlab.launch.launcher import complain
from estlab.metrics.intervals import Estimate
from estlab.metrics.vocabulary import column_heading, split_column, usual_columns, written
from estlab.report import grids
from estlab.report.console import print_line
from estlab.report.grids import Grid
from estlab.rundir.layout import ATTEMPTS, GROUPS, SWEEP
from estlab.sweeps import split, table
from estlab.sweeps.state import Outcome, Planned

_LINES = 40  # rows of a table that are shown
_FAILURES = 20

_ERRORS = 4  # components whose RMSE is printed


def plan(planned: Sequence[Planned], outcomes: Mapping[str, Outcome]) -> None:
    """A line a job: its directory, what is typed for it, and whether it is done."""
    width = max(len(job.name) for job in planned)
    for job in planned:
        words = [word for word in job.overrides if word not in OF_A_SWEEP and not word.startswith("sweep.")]
        found = outcomes[job.name]
        done = f"  ({found.state})" if found.whole else ""
        print_line(f"{job.name:{width}}  {' '.join(words)}{done}")
    left = sum(not outcomes[job.name].whole for job in planned)
    parts = sum(job.parts for job in planned)
    split_up = f" in {parts} parts" if parts > len(planned) else ""
    print_line(f"{len(planned)} job{'s' * (len(planned) > 1)}{split_up}, {left} to run")


def fewer_parts(planned: Sequence[Planned], wanted: int) -> None:
    """Reports that jobs have fewer parts than requested."""
    fewer = [job for job in planned if job.parts < wanted]
    if fewer:
        most = max(job.parts for job in fewer)
        jobs = f"{len(fewer)} jobs run" if len(fewer) > 1 else f"{fewer[0].name} runs"
        parts = f"{'at most ' * (len({job.parts for job in fewer}) > 1)}{most} part{'s' * (most > 1)}"
        why = f"{jobs} in {parts}, one for each block of block_runs runs; a lower block_runs makes more"
        complain(f"sweep.split_runs={wanted}: {why}")


def resumed(sweep: Path, planned: Sequence[Planned], before: Mapping[str, Outcome]) -> None:
    """Reports the state of an existing sweep, and which of its jobs are damaged."""
    if all(outcome.state == "left" for outcome in before.values()):
        return
    done = [job for job in planned if before[job.name].whole]
    rest = "the others will run" if len(done) < len(planned) else "nothing is left to run"
    parts = [part.name for job in planned if job not in done for part in split.parts_of(job)]
    ready = sum(before[name].whole for name in parts)
    of_parts = f" and {ready} of {len(parts)} parts of the others" if parts else ""
    complain(f"{sweep}: {len(done)} of {len(planned)} jobs{of_parts} are done, {rest}")
    damaged(before)


def damaged(before: Mapping[str, Outcome]) -> None:
    """Reports what remains of an earlier attempt and cannot be used."""
    for name, outcome in before.items():
        if outcome.state == "damaged":
            kept = f"its files are kept in {ATTEMPTS}/"
            complain(f"job {name}: {outcome.error}; it runs again, {kept}")


def summary(
    sweep: Path, planned: Sequence[Planned], outcomes: Mapping[str, Outcome], repeats: int, notes: Sequence[str]
) -> None:
    """A line for each job and filter, or for each group of repeats; every failure, the counts, and the directory."""
    rows = jobs = table.job_rows(planned, outcomes)
    keys = [*table.swept_keys(planned), "filter"]
    columns = ["job", *keys, "status"]
    if repeats > 1:
        rows = table.group_rows(jobs, planned)
        columns = [*(key for key in keys if key != "seed"), "repeats"]
    grids.show(_grid(rows[:_LINES], columns, table.units(outcomes)))
    if len(rows) > _LINES:
        print_line(f"and {len(rows) - _LINES} more rows in {SWEEP if repeats == 1 else GROUPS}")
    failures(sweep, [(unit.name, outcomes[unit.name]) for unit in split.units(planned)])
    for note in notes:
        print_line(f"note: {note}")
    counts = Counter({row["job"]: row["status"] for row in jobs}.values())
    print_line(", ".join(f"{counts[word]} {word}" for word in ("ok", "unmet", "failed", "left") if counts[word]))
    print_line(str(sweep))


def differing_plugins(outcomes: Mapping[str, Outcome]) -> list[str]:
    """A line for each module of plugins whose source differs between jobs that are ok."""
    hashes: dict[str, Counter[str]] = {}
    for found in outcomes.values():
        for module, digest in found.plugins.items():
            hashes.setdefault(module, Counter())[digest[:12]] += 1
    return [
        f"the source of {module} differs between jobs (SHA-256 "
        f"{', '.join(f'{digest} in {count}' for digest, count in counts.items())}); figures may differ "
        "because of it"
        for module, counts in hashes.items()
        if len(counts) > 1
    ]


def failures(sweep: Path, outcomes: Sequence[tuple[str, Outcome]]) -> None:
    """A line for each job and part that failed or found what was not expected, as many as a person reads."""
    failed = [(name, found) for name, found in outcomes if found.state in ("unmet", "failed", "damaged")]
    for name, found in failed[:_FAILURES]:
        word = "unmet" if found.whole else "failed"
        print_line(f"{word}: {name}: {found.error} ({sweep / name})")
    if len(failed) > _FAILURES:
        print_line(f"and {len(failed) - _FAILURES} more, by their status in {SWEEP}")


def _grid(rows: Sequence[table.SweepRow], columns: Sequence[str], units: Mapping[str, str]) -> Grid:
    """The rows with the few metrics that a terminal has room for."""
    metrics = usual_columns(list(rows[0]) if rows else [], _ERRORS)
    headings = [*columns, *(column_heading(one, units.get(one, "")) for one in metrics)]
    lines = []
    for row in rows:
        cells = [row[column].partition("_")[0] if column == "job" else row[column] for column in columns]
        lines.append([*cells, *(_written(row, metric) for metric in metrics)])
    return Grid("", headings, lines)


def _written(row: table.SweepRow, column: str) -> str:
    """A metric of a row, a verdict as it is."""
    try:
        value, low, high = (float(row.get(name) or "nan") for name in (column, f"{column}.low", f"{column}.high"))
    except ValueError:
        return row[column]
    return written(split_column(column)[0], Estimate(value, low, high, 0))
