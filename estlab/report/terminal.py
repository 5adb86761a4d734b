"""What a person sees: a progress bar, a short table, the path; plain lines where there is no terminal."""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

_EVERY = 0.1  # seconds between updates of the bar


def console() -> Console:
    """Standard output; wide enough for the tables where it is not a terminal."""
    out = Console(highlight=False)
    return out if out.is_terminal else Console(highlight=False, width=120, color_system=None)


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


def summary(title: str, rows: Sequence[Mapping[str, Any]], remarks: Sequence[str], where: str) -> None:
    """Print the result of one run: errors by component, consistency, divergence, where it is."""
    out = console()
    by = {(row["metric"], row["component"]): row for row in rows}
    table = Table(title=title, title_justify="left", title_style="bold", box=None, pad_edge=False)
    table.add_column("")
    for heading in ("RMSE", "95 % interval", "median |error|", "mean sigma", "inside 3 sigma", "time scored"):
        table.add_column(heading, justify="right")
    for row in rows:
        if row["metric"] == "rmse":
            name = row["component"]
            cells = (_number(by.get((metric, name))) for metric in ("median_abs_error", "mean_sigma"))
            shares = (_share(by.get((metric, name))) for metric in ("inside_3sigma", "scored"))
            table.add_row(Text(f"{name} [{row['unit']}]"), _number(row), _interval(row), *cells, *shares)
    out.print(table)
    for metric, words in (("anees", "NEES / n"), ("anis", "NIS / m")):
        if (metric, "all") in by:
            found = by[metric, "all"]
            interval = f", 95 % interval {_interval(found)}" if _interval(found) else ""
            out.print(f"{words} = {_number(found)}{interval} (1 when consistent)")
    diverged = by["diverged", "all"]
    out.print(f"{diverged['value']:.0f} of {diverged['n']} runs diverged")
    for remark in remarks:
        out.print(Text(f"note: {remark}"), soft_wrap=True)
    out.print(Text(where), soft_wrap=True)


def _number(row: Mapping[str, Any] | None) -> str:
    return "" if row is None or row["value"] != row["value"] else f"{row['value']:.3g}"


def _interval(row: Mapping[str, Any]) -> str:
    return f"{row['ci_low']:.3g} to {row['ci_high']:.3g}" if row["ci_low"] == row["ci_low"] else ""


def _share(row: Mapping[str, Any] | None) -> str:
    return "" if row is None or row["value"] != row["value"] else f"{100.0 * row['value']:.1f} %"
