"""estlab compare: runs side by side, and run by run where they met the same truth."""

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from estlab.errors import UserError, printable
from estlab.launch.launcher import FAILED, OK, complain
from estlab.launch.path_arguments import home

if TYPE_CHECKING:
    from estlab.comparison.pairing import Pair
    from estlab.comparison.rows import ComparisonRow, Metric
    from estlab.report.grids import Grid

HELP = """\
estlab compare DIR [DIR ...] [--metric NAME[.COMPONENT]] [--against ROW] [--csv FILE|-] [--md | --latex] [--plot FILE]

DIR is a run directory, a folder that holds some (a day's, a sweep's, runs/latest), or a pattern in quotes. Each
filter of each run is a row, named by what differs. Where two met the same truth and readings, the difference of
their RMSE is taken run by run, with its interval and Holm's p-value; where not, it is said why.

  --metric rmse.position   a column; may be repeated. Without a component, all of them
  --against 2              the row that the others are held against: its number, label, filter or directory; 1
  --csv FILE               the table as CSV, numbers in full; - for standard output
  --md, --latex            the tables for Markdown, for LaTeX (booktabs), instead of the terminal's
  --plot FILE.png          RMSE and NEES over time, overlaid; .png, .pdf or .svg

Exit codes: 0 ok, 1 no run that can be compared, 2 usage.
"""

_VALUED = ("--metric", "--against", "--csv", "--plot")
_FLAGS = ("--md", "--latex")
_PICTURES = (".png", ".pdf", ".svg")


@dataclass
class Wanted:
    """What the command line asks for."""

    words: list[str] = field(default_factory=list)
    metrics: list[str] = field(default_factory=list)
    against: str = "1"
    csv: str = ""
    form: str = ""
    plot: Path | None = None


def compare(arguments: Sequence[str]) -> int:
    """Compare what the words name; the exit code."""
    if {"-h", "--help"} & set(arguments):
        print(HELP, end="")
        return OK
    wanted = _read(arguments)
    from estlab.rundir.search import run_directories

    rows, left_out = _rows(run_directories(wanted.words))
    for line in left_out:
        complain(line)
    if not rows:
        return complain("there is no run that can be compared", FAILED)
    from estlab.comparison.differences import unlike
    from estlab.comparison.pairing import pairs

    metrics = _metrics(rows, wanted.metrics)
    for line in unlike(rows, metrics):
        complain(f"warning: {line}")
    components = [component for name, component in metrics if name == "rmse"]
    against = _against(rows, wanted.against)
    compared, unread = pairs(rows, rows[against - 1], components) if components and len(rows) > 1 else ({}, [])
    for line in unread:
        complain(line)
    _show(wanted, rows, metrics, components, against, compared)
    if wanted.plot:
        _plot(wanted.plot, rows, components)
    return OK


def _read(arguments: Sequence[str]) -> Wanted:
    """The command line; raises UserError for what it cannot mean."""
    from estlab.config.build import nearest

    wanted = Wanted()
    words = iter(arguments)
    for word in words:
        flag, equals, value = word.partition("=")
        if not word.startswith("-"):
            wanted.words.append(word)
        elif flag in _VALUED:
            value = value if equals else next(words, "")
            if not value:
                raise UserError(f"{flag} takes a value; see estlab compare --help")
            if flag == "--metric":
                wanted.metrics.append(value)
            elif flag == "--against":
                wanted.against = value
            elif flag == "--csv":
                wanted.csv = home(value)
            else:
                wanted.plot = Path(home(value))
        elif word in _FLAGS:
            if wanted.form not in ("", word):
                raise UserError("--md and --latex are two forms of one output; take one")
            wanted.form = word
        else:
            raise UserError(f"estlab compare has no {word}{nearest(word, [*_VALUED, *_FLAGS])}")
    if not wanted.words:
        raise UserError("estlab compare takes run directories, for example estlab compare runs/2026-01-31; see --help")
    if wanted.csv == "-" and wanted.form:
        raise UserError(f"--csv - and {wanted.form} both go to standard output; name a file for the CSV")
    if wanted.plot and wanted.plot.suffix.lower() not in _PICTURES:
        raise UserError(f"--plot {wanted.plot}: the picture must end in {', '.join(_PICTURES)}")
    return wanted


def _rows(paths: Sequence[Path]) -> "tuple[list[ComparisonRow], list[str]]":
    """The rows of all runs that are whole, and a line for each of the others."""
    from estlab.comparison.rows import labelled, rows_of
    from estlab.rundir import finished

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


def _metrics(rows: "Sequence[ComparisonRow]", names: Sequence[str]) -> "list[Metric]":
    """The columns: those named, or errors of the position or of all together, or of each component, and verdicts."""
    from estlab.config.build import nearest
    from estlab.report.compared import VERDICT

    known = list(dict.fromkeys([*(metric for row in rows for metric in row.metrics), VERDICT]))
    if not names:
        errors = dict.fromkeys(metric for row in rows for metric in _errors(row))
        usual = [("anees", "all"), ("anis", "all"), ("diverged", "all"), VERDICT]
        return [*errors, *(metric for metric in usual if metric in known)]
    chosen: list[Metric] = []
    for name in names:
        found = [metric for metric in known if name in (metric[0], ".".join(metric))]
        if not found:
            near = nearest(name, [".".join(metric) for metric in known])
            raise UserError(f"--metric {name}: no run has it{near or '; their metrics.csv lists what there is'}")
        chosen += found
    return list(dict.fromkeys(chosen))


def _errors(row: "ComparisonRow") -> "list[Metric]":
    errors = [metric for metric in row.metrics if metric[0] == "rmse"]
    return [metric for metric in (("rmse", "position"), ("rmse", "all")) if metric in errors][:1] or errors


def _against(rows: "Sequence[ComparisonRow]", wanted: str) -> int:
    """The number of the row that is meant."""
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
            raise UserError(f"--against {wanted}: rows {', '.join(map(str, found))} are; give one's number")
    raise UserError(f"--against {wanted}: there is no such row; give a number from 1 to {len(rows)}")


def _show(
    wanted: Wanted,
    rows: "Sequence[ComparisonRow]",
    metrics: "Sequence[Metric]",
    components: Sequence[str],
    against: int,
    compared: "dict[str, Pair]",
) -> None:
    """Every output but the picture."""
    from estlab.datasets.whole import write_whole
    from estlab.report import compared as shown
    from estlab.report import grids

    write = partial(shown.write, rows, metrics, against, compared, components)
    if wanted.csv == "-":
        sys.stdout.flush()
        write(sys.stdout.buffer)
        return
    if wanted.csv:
        write_whole(Path(wanted.csv), write)
    differences = shown.differences_grid(rows, against, compared, components)
    for grid in (shown.metrics_grid(rows, metrics), differences):
        if grid:
            _print(grid, wanted.form)
    for line in shown.not_paired(rows, against, compared):
        if wanted.form:
            complain(line)
        else:
            grids.say(line)


def _print(grid: "Grid", form: str) -> None:
    from estlab.report import grids

    if form:
        print({"--md": grids.markdown, "--latex": grids.latex}[form](grid))
    else:
        grids.show(grid)


def _plot(file: Path, rows: "Sequence[ComparisonRow]", components: Sequence[str]) -> None:
    """Draw the overlay, of the rows whose tables can be read."""
    from estlab.datasets.whole import write_whole
    from estlab.report import overlay
    from estlab.report.figures import boxes_for_letters

    curves, unread = overlay.curves_of(rows)
    for line in unread:
        complain(line)
    if not curves:
        complain(f"{file}: nothing to draw, no run has two steps or more")
        return
    if len(curves) > overlay.MOST:
        complain(f"{file}: shows the first {overlay.MOST} of {len(curves)} rows, more would not be told apart")
    figure = overlay.draw(curves[: overlay.MOST], components)
    with boxes_for_letters():
        write_whole(file, lambda stream: figure.savefig(stream, format=file.suffix[1:].lower(), dpi=110))
    print(printable(str(file)), file=sys.stderr)
