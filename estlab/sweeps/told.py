"""What a person sees of a sweep before and after its jobs."""

import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

from rich.table import Table
from rich.text import Text

from estlab.report import terminal
from estlab.sweeps import state, table
from estlab.sweeps.state import Outcome, Planned

_LINES = 40  # rows of a table that are shown
_FAILURES = 20


def plan(planned: Sequence[Planned], outcomes: Mapping[str, Outcome]) -> None:
    """A line a job: its directory, what is typed for it, and whether it is done."""
    out = terminal.console()
    width = max(len(job.name) for job in planned)
    for job in planned:
        done = "  (ok)" if outcomes[job.name].state == "ok" else ""
        out.print(Text(f"{job.name:{width}}  {' '.join(job.overrides)}{done}"), soft_wrap=True)
    left = sum(outcome.state != "ok" for outcome in outcomes.values())
    out.print(f"{len(planned)} jobs, {left} to run")


def resumed(sweep: Path, planned: Sequence[Planned], before: Mapping[str, Outcome]) -> None:
    """What a sweep that was there already has, and which jobs of it are not as they should be."""
    states = Counter(outcome.state for outcome in before.values())
    if states["left"] == len(planned):
        return
    print(f"estlab: {sweep}: {states['ok']} of {len(planned)} jobs are ok, the others run", file=sys.stderr)
    for name, outcome in before.items():
        if outcome.state == "damaged":
            kept = f"its files are kept in {state.ATTEMPTS}/"
            print(f"estlab: job {name}: {outcome.error}; it runs again, {kept}", file=sys.stderr)


def summary(sweep: Path, planned: Sequence[Planned], outcomes: Mapping[str, Outcome], notes: Sequence[str]) -> None:
    """A line a job and filter, every failure, how many of each, and where it all is."""
    out = terminal.console()
    rows = table.job_rows(planned, outcomes)
    out.print(_jobs(rows[:_LINES], [*table.swept_keys(planned), "filter"], table.units(outcomes)))
    if len(rows) > _LINES:
        out.print(f"and {len(rows) - _LINES} rows more in {table.SWEEP}")
    failures = [
        row
        for row in table.failure_rows(sweep, planned, outcomes)
        if not row["directory"].startswith(f"{state.ATTEMPTS}/")
    ]
    for row in failures[:_FAILURES]:
        out.print(Text(f"failed: {row['job']}: {row['error']} ({sweep / row['directory']})"), soft_wrap=True)
    if len(failures) > _FAILURES:
        out.print(f"and {len(failures) - _FAILURES} failures more in {table.FAILURES}")
    for note in notes:
        out.print(Text(f"note: {note}"), soft_wrap=True)
    counts = Counter(row["status"] for row in {row["job"]: row for row in rows}.values())
    out.print(", ".join(f"{counts[word]} {word}" for word in ("ok", "failed", "left") if counts[word]))
    out.print(Text(str(sweep)), soft_wrap=True)


def _jobs(rows: Sequence[table.Row], keys: Sequence[str], units: Mapping[str, str]) -> Table:
    shown = Table(box=None, pad_edge=False)
    metrics = _metrics(rows)
    headings = [f"{name.replace('rmse.', 'RMSE ')} [{units[name]}]" if units.get(name) else name for name in metrics]
    headings = [
        heading.replace("anees.all", "NEES / n").replace("anis.all", "NIS / m").replace(".all", "")
        for heading in headings
    ]
    for i, heading in enumerate(["job", *keys, "status", *headings]):
        shown.add_column(Text(heading), justify="left" if i == 0 else "right")
    for row in rows:
        numbers = [f"{float(row[name]):.3g}" if row[name] else "" for name in metrics]
        shown.add_row(
            *(
                Text(cell)
                for cell in [row["job"].partition("_")[0], *(row[key] for key in keys), row["status"], *numbers]
            )
        )
    return shown


def _metrics(rows: Sequence[table.Row]) -> list[str]:
    """The few metrics that a terminal has room for: the position's RMSE, or each component's, and consistency."""
    columns = list(rows[0]) if rows else []
    errors = [c for c in columns if c.startswith("rmse.") and not c.endswith((".low", ".high"))]
    errors = [c for c in errors if c == "rmse.position"] or errors[:4]
    return [*errors, *(c for c in ("anees.all", "anis.all", "diverged.all") if c in columns)]
