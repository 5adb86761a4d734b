"""estlab compare: runs side by side, and run by run where they met the same truth."""

import argparse
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from estlab.cli.parser import FILE, TEXT, Parser
from estlab.errors import UserError, printable
from estlab.launch.launcher import FAILED, OK, complain

if TYPE_CHECKING:
    from estlab.comparison.pairing import Pair
    from estlab.comparison.rows import ComparisonRow
    from estlab.metrics.vocabulary import Metric
    from estlab.report.grids import Grid

_PICTURES = (".png", ".pdf", ".svg")
_STDOUT = Path("-")


class CompareOptions(argparse.Namespace):
    """The options of the command line."""

    directories: list[str]
    metric: list[str]
    against: str
    csv: Path | None
    md: bool
    latex: bool
    plot: Path | None


def parser() -> Parser:
    """The command line of estlab compare."""
    found = Parser(
        "compare",
        "compare DIR [DIR ...] [--metric NAME[.COMPONENT]] [--against ROW]\n"
        "                      [--csv FILE|-] [--md | --latex] [--plot FILE]",
        "DIR is a run directory, a folder of run directories (a day's, a sweep's,\n"
        "runs/latest), or a pattern in quotes. Each filter of each run is a row, named\n"
        "by what differs. If two met the same truth and readings, the difference of\n"
        "their RMSE is taken run by run, with its interval and Holm's p-value; if not,\n"
        "the reason is printed.",
        "exit codes: 0 ok, 1 no run that can be compared, 2 usage",
    )
    found.add_argument("directories", metavar="DIR", nargs="*", help="run directories, folders of them, patterns")
    metric = "a column, such as rmse.position; may be repeated. Without a component, all of them"
    found.add_argument("--metric", type=TEXT, action="append", default=[], metavar="NAME", help=metric)
    against = "the row to compare the others with: its number, label, filter or directory (1)"
    found.add_argument("--against", type=TEXT, default="1", metavar="ROW", help=against)
    csv = "write the table as CSV with full precision; - for standard output"
    found.add_argument("--csv", type=FILE, metavar="FILE", help=csv)
    found.add_argument("--md", action="store_true", help="print the tables for Markdown")
    found.add_argument("--latex", action="store_true", help="print the tables for LaTeX (booktabs)")
    plot = f"draw RMSE and NEES over time, overlaid; {', '.join(_PICTURES[:-1])} or {_PICTURES[-1]}"
    found.add_argument("--plot", type=FILE, metavar="FILE", help=plot)
    return found


def compare(arguments: Sequence[str]) -> int:
    """Compare the runs that the words name. Returns the exit code."""
    options = _read(arguments)
    from estlab.api import comparing
    from estlab.rundir.search import run_directories

    rows, left_out = comparing.comparable_rows(run_directories(options.directories))
    for line in left_out:
        complain(line)
    if not rows:
        return complain("no run can be compared", FAILED)
    from estlab.comparison.differences import mismatches
    from estlab.comparison.pairing import pairs

    metrics = comparing.chosen_metrics(rows, options.metric)
    for line in mismatches(rows, metrics):
        complain(f"warning: {line}")
    components = [component for name, component in metrics if name == "rmse"]
    against = comparing.number_of(rows, options.against)
    compared, unread = pairs(rows, rows[against - 1], components) if components and len(rows) > 1 else ({}, [])
    for line in unread:
        complain(line)
    _show(options, rows, metrics, components, against, compared)
    if options.plot:
        _plot(options.plot, rows, components)
    return OK


def _read(arguments: Sequence[str]) -> CompareOptions:
    """Parse the command line. Raises UserError for invalid words."""
    options = parser().read(arguments, CompareOptions())
    if not options.directories:
        raise UserError("estlab compare takes run directories, for example estlab compare runs/2026-01-31; see --help")
    if options.md and options.latex:
        raise UserError("--md and --latex exclude each other; choose one")
    if options.csv == _STDOUT and (options.md or options.latex):
        form = "--md" if options.md else "--latex"
        raise UserError(f"--csv - and {form} both go to standard output; name a file for the CSV")
    if options.plot and options.plot.suffix.lower() not in _PICTURES:
        raise UserError(f"--plot {options.plot}: the picture must end in {', '.join(_PICTURES)}")
    return options


def _show(
    options: CompareOptions,
    rows: "Sequence[ComparisonRow]",
    metrics: "Sequence[Metric]",
    components: Sequence[str],
    against: int,
    pairs: "dict[str, Pair]",
) -> None:
    """Print everything except the picture."""
    from estlab.datasets.whole import write_whole
    from estlab.report import compared
    from estlab.report.console import print_line

    write = partial(compared.write, compared.lines(rows, metrics, against, pairs, components))
    if options.csv == _STDOUT:
        sys.stdout.flush()
        write(sys.stdout.buffer)
        return
    if options.csv:
        write_whole(options.csv, write)
    differences = compared.differences_grid(rows, against, pairs, components)
    for grid in (compared.metrics_grid(rows, metrics), differences):
        if grid:
            _print(grid, options)
    for line in compared.not_paired(rows, against, pairs):
        if options.md or options.latex:
            complain(line)
        else:
            print_line(line)


def _print(grid: "Grid", options: CompareOptions) -> None:
    from estlab.report import grids

    if options.md or options.latex:
        print(grids.markdown(grid) if options.md else grids.latex(grid))
    else:
        grids.show(grid)


def _plot(file: Path, rows: "Sequence[ComparisonRow]", components: Sequence[str]) -> None:
    """Draw the overlay of the rows whose tables can be read."""
    from estlab.datasets.whole import write_whole
    from estlab.report import overlay, palette
    from estlab.report.figures import boxes_for_letters

    curves, unread = overlay.curves_of(rows)
    for line in unread:
        complain(line)
    if not curves:
        complain(f"{file}: nothing to draw, because no run has two steps or more")
        return
    if len(curves) > palette.MOST:
        complain(f"{file}: shows the first {palette.MOST} of {len(curves)} rows, because more could not be told apart")
    figure = overlay.draw(curves[: palette.MOST], components)
    with boxes_for_letters():
        write_whole(file, lambda stream: figure.savefig(stream, format=file.suffix[1:].lower(), dpi=110))
    print(printable(str(file)), file=sys.stderr)
