"""The table of what was expected and what was found."""

from collections.abc import Iterable, Sequence

from rich.table import Table
from rich.text import Text

from estlab.report.console import console

HEADINGS = ("filter", "expectation", "expected", "found", "")


def show(headings: Sequence[str], lines: Iterable[Sequence[str]]) -> None:
    """Print a table whose last column says ok or FAILED."""
    table = Table(box=None, pad_edge=False)
    for heading in headings:
        table.add_column(Text(heading), overflow="fold")
    for *cells, outcome in lines:
        table.add_row(*map(Text, cells), Text(outcome, style="" if outcome == "ok" else "bold red"))
    console().print(table)
