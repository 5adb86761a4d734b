"""What a person sees: a progress bar, a short table, the path; plain lines where there is no terminal."""

import os
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

Row = Mapping[str, Any]

_EVERY = 0.1  # seconds between updates of the bar


class _Console(Console):
    """A console whose reader may leave, as head does, without ending the run: its results are on the disk."""

    def on_broken_pipe(self) -> None:
        self.quiet = True
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def console() -> Console:
    """Standard output; wide enough for the tables where it is not a terminal."""
    out = _Console(highlight=False)
    return out if out.is_terminal else _Console(highlight=False, width=240, color_system=None)


@contextmanager
def progress(total: int, what: str) -> Iterator[Callable[[], None]]:
    """A bar for work of this many ticks, shown only on a terminal and only if it lasts."""
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    screen = Console(stderr=True)
    if not screen.is_terminal:
        yield lambda: None
        return
    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()
    with Progress(*columns, console=screen, transient=True) as bar:
        task = bar.add_task(what, total=total)
        done, shown = 0, time.monotonic()

        def tick() -> None:
            nonlocal done, shown
            done += 1
            if time.monotonic() - shown > _EVERY:
                bar.update(task, completed=done)
                shown = time.monotonic()

        yield tick


def summary(
    title: str,
    rows: Mapping[str, Sequence[Row]],
    own: Mapping[str, Sequence[Any]],
    remarks: Sequence[str],
    where: str,
) -> None:
    """Print the result: a line a component for one filter, a line a filter for several; the problem's own; the path."""
    out = console()
    by = {name: {(row["metric"], row["component"]): row for row in found} for name, found in rows.items()}
    out.print(_components(title, by) if len(by) == 1 else _filters(title, by))
    if len(by) == 1:
        _print_consistency(out, next(iter(by.values())))
    if own:
        table = _table("", list(own))
        for cells in zip(*own.values(), strict=True):
            table.add_row(*(cell if isinstance(cell, str) else _cell(cell) for cell in cells))
        out.print(table)
    for remark in remarks:
        out.print(Text(f"note: {remark}"), soft_wrap=True)
    out.print(Text(where), soft_wrap=True)


def _components(title: str, by: Mapping[str, Mapping[tuple[str, str], Row]]) -> Table:
    """A line a component, for one filter."""
    (found,) = by.values()
    columns = ("", "RMSE", "95 % interval", "median |error|", "mean sigma", "inside 3 sigma", "time scored")
    table = _table(title, columns)
    for row in found.values():
        if row["metric"] == "rmse":
            name = row["component"]
            cells = (_number(found.get((metric, name))) for metric in ("median_abs_error", "mean_sigma"))
            shares = (_share(found.get((metric, name))) for metric in ("inside_3sigma", "scored"))
            table.add_row(Text(f"{name} [{row['unit']}]"), _number(row), _interval(row), *cells, *shares)
    return table


def _filters(title: str, by: Mapping[str, Mapping[tuple[str, str], Row]]) -> Table:
    """A line a filter: RMSE of each component, consistency, what went wrong."""
    first = next(iter(by.values()))
    errors = [row for row in first.values() if row["metric"] == "rmse"]
    extra = [m for m in ("found", "ess") if any((m, c) in found for found in by.values() for c in ("all", "position"))]
    names = [f"RMSE {row['component']} [{row['unit']}]" for row in errors]
    table = _table(title, ("", *names, "NEES / n", "NIS / m", *extra, "diverged"))
    for name, found in by.items():
        cells = [_number(found.get(("rmse", row["component"]))) for row in errors]
        cells += [_number(found.get((metric, "all"))) for metric in ("anees", "anis")]
        cells += [_number(found.get((m, "position")) or found.get((m, "all"))) for m in extra]
        lost = found["diverged", "all"]
        table.add_row(Text(name), *cells, f"{lost['value']:.0f} of {lost['n']}")
    return table


def _table(title: str, headings: Sequence[str]) -> Table:
    table = Table(title=title or None, title_justify="left", title_style="bold", box=None, pad_edge=False)
    for i, heading in enumerate(headings):
        table.add_column(Text(heading), justify="left" if i == 0 else "right")
    return table


def _print_consistency(out: Console, found: Mapping[tuple[str, str], Row]) -> None:
    for metric, words in (("anees", "NEES / n"), ("anis", "NIS / m")):
        if _number(found.get((metric, "all"))):
            row = found[metric, "all"]
            interval = f", 95 % interval {_interval(row)}" if _interval(row) else ""
            out.print(f"{words} = {_number(row)}{interval} (1 when consistent)")
    if ("found", "position") in found:
        when = found["found_time", "position"]
        since = f", from {_number(when)} s on in the mean" if when["n"] else ""
        out.print(f"{_share(found['found', 'position'])} of the runs found the position{since}")
    if ("ess", "all") in found:
        out.print(f"effective sample size {_number(found['ess', 'all'])} in the mean")
    if ("vanished", "all") in found:
        out.print(f"all weights vanished at {found['vanished', 'all']['value']:.0f} readings")
    if ("gated", "all") in found:
        out.print(f"{found['gated', 'all']['value']:.0f} readings gated")
    diverged = found["diverged", "all"]
    out.print(f"{diverged['value']:.0f} of {diverged['n']} runs diverged")


def _cell(value: float) -> str:
    return "" if value != value else f"{value:.10g}"


def _number(row: Mapping[str, Any] | None) -> str:
    return "" if row is None or row["value"] != row["value"] else f"{row['value']:.3g}"


def _interval(row: Mapping[str, Any]) -> str:
    return f"{row['ci_low']:.3g} to {row['ci_high']:.3g}" if row["ci_low"] == row["ci_low"] else ""


def _share(row: Mapping[str, Any] | None) -> str:
    return "" if row is None or row["value"] != row["value"] else f"{100.0 * row['value']:.1f} %"
