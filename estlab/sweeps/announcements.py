"""What a person sees of a sweep before and after its jobs."""

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

from rich.table import Table
from rich.text import Text

from estlab.launch.arguments import OF_A_SWEEP
from estlab.launch.launcher import complain
from estlab.report.console import console
from estlab.sweeps import split, state, table
from estlab.sweeps.state import Outcome, Planned

_LINES = 40  # rows of a table that are shown
_FAILURES = 20

_WORDS = {"anees.all": "NEES / n", "anis.all": "NIS / m", "diverged.all": "diverged"}


def plan(planned: Sequence[Planned], outcomes: Mapping[str, Outcome]) -> None:
    """A line a job: its directory, what is typed for it, and whether it is done."""
    out = console()
    width = max(len(job.name) for job in planned)
    for job in planned:
        words = [word for word in job.overrides if word not in OF_A_SWEEP and not word.startswith("sweep.")]
        found = outcomes[job.name]
        done = f"  ({found.state})" if found.whole else ""
        out.print(Text(f"{job.name:{width}}  {' '.join(words)}{done}"), soft_wrap=True)
    left = sum(not outcomes[job.name].whole for job in planned)
    parts = sum(job.parts for job in planned)
    split_up = f" in {parts} parts" if parts > len(planned) else ""
    out.print(f"{len(planned)} job{'s' * (len(planned) > 1)}{split_up}, {left} to run")


def fewer_parts(planned: Sequence[Planned], wanted: int) -> None:
    """That jobs have fewer parts than were asked for."""
    fewer = [job for job in planned if job.parts < wanted]
    if fewer:
        most = max(job.parts for job in fewer)
        jobs = f"{len(fewer)} jobs run" if len(fewer) > 1 else f"{fewer[0].name} runs"
        parts = f"{'at most ' * (len({job.parts for job in fewer}) > 1)}{most} part{'s' * (most > 1)}"
        told = f"{jobs} in {parts}, one for each block of block_runs runs; a lower block_runs makes more"
        complain(f"sweep.split_runs={wanted}: {told}")


def resumed(sweep: Path, planned: Sequence[Planned], before: Mapping[str, Outcome]) -> None:
    """What a sweep that was there already has, and which jobs of it are not as they should be."""
    if all(outcome.state == "left" for outcome in before.values()):
        return
    done = [job for job in planned if before[job.name].whole]
    rest = "the others run" if len(done) < len(planned) else "nothing is left to run"
    parts = [part.name for job in planned if job not in done for part in split.parts_of(job)]
    ready = sum(before[name].whole for name in parts)
    of_parts = f" and {ready} of {len(parts)} parts of the others" if parts else ""
    complain(f"{sweep}: {len(done)} of {len(planned)} jobs{of_parts} are done, {rest}")
    damaged(before)


def damaged(before: Mapping[str, Outcome]) -> None:
    """What of an earlier attempt cannot be used."""
    for name, outcome in before.items():
        if outcome.state == "damaged":
            kept = f"what there is of it is kept in {state.ATTEMPTS}/"
            complain(f"job {name}: {outcome.error}; it runs again, {kept}")


def summary(
    sweep: Path, planned: Sequence[Planned], outcomes: Mapping[str, Outcome], repeats: int, notes: Sequence[str]
) -> None:
    """A line a job and filter, or a line a group of repeats; every failure, how many of each, and where it all is."""
    out = console()
    rows = jobs = table.job_rows(planned, outcomes)
    keys = [*table.swept_keys(planned), "filter"]
    columns = ["job", *keys, "status"]
    if repeats > 1:
        rows = table.group_rows(jobs, planned)
        columns = [*(key for key in keys if key != "seed"), "repeats"]
    out.print(_table(rows[:_LINES], columns, table.units(outcomes)))
    if len(rows) > _LINES:
        out.print(f"and {len(rows) - _LINES} rows more in {table.SWEEP if repeats == 1 else table.GROUPS}")
    failures(sweep, [(unit.name, outcomes[unit.name]) for unit in split.units(planned)])
    for note in notes:
        out.print(Text(f"note: {note}"), soft_wrap=True)
    counts = Counter({row["job"]: row["status"] for row in jobs}.values())
    out.print(", ".join(f"{counts[word]} {word}" for word in ("ok", "unmet", "failed", "left") if counts[word]))
    out.print(Text(str(sweep)), soft_wrap=True)


def unlike_plugins(outcomes: Mapping[str, Outcome]) -> list[str]:
    """A line for each module of plugins whose source is not the same in all jobs that are ok."""
    hashes: dict[str, Counter[str]] = {}
    for found in outcomes.values():
        for module, digest in found.plugins.items():
            hashes.setdefault(module, Counter())[digest[:12]] += 1
    return [
        f"the source of {module} is not the same in all jobs (SHA-256 "
        f"{', '.join(f'{digest} in {count}' for digest, count in counts.items())}); figures may differ because of it"
        for module, counts in hashes.items()
        if len(counts) > 1
    ]


def failures(sweep: Path, outcomes: Sequence[tuple[str, Outcome]]) -> None:
    """A line for each job and part that failed or found what was not expected, as many as a person reads."""
    out = console()
    failed = [(name, found) for name, found in outcomes if found.state in ("unmet", "failed", "damaged")]
    for name, found in failed[:_FAILURES]:
        word = "unmet" if found.whole else "failed"
        out.print(Text(f"{word}: {name}: {found.error} ({sweep / name})"), soft_wrap=True)
    if len(failed) > _FAILURES:
        out.print(f"and {len(failed) - _FAILURES} more, by their status in {table.SWEEP}")


def _table(rows: Sequence[table.SweepRow], columns: Sequence[str], units: Mapping[str, str]) -> Table:
    shown = Table(box=None, pad_edge=False)
    metrics = _metrics(rows)
    for i, column in enumerate([*columns, *metrics]):
        shown.add_column(Text(_heading(column, units)), justify="left" if i == 0 else "right")
    for row in rows:
        told = [row[column].partition("_")[0] if column == "job" else row[column] for column in columns]
        numbers = [_number(row[name]) for name in metrics]
        shown.add_row(*(Text(cell) for cell in [*told, *numbers]))
    return shown


def _heading(column: str, units: Mapping[str, str]) -> str:
    if column in _WORDS:
        return _WORDS[column]
    unit = f" [{units[column]}]" if units.get(column) else ""
    return column.replace("rmse.", "RMSE ") + unit


def _metrics(rows: Sequence[table.SweepRow]) -> list[str]:
    """The few metrics that a terminal has room for: the position's RMSE, or each component's, and consistency."""
    columns = list(rows[0]) if rows else []
    errors = [c for c in columns if c.startswith("rmse.") and not c.endswith((".low", ".high"))]
    errors = [c for c in errors if c in ("rmse.position", "rmse.all")][:1] or errors[:4]
    return [*errors, *(column for column in [*_WORDS, table.VERDICT] if column in columns)]


def _number(cell: str) -> str:
    try:
        return f"{float(cell):.3g}"
    except ValueError:
        return cell
