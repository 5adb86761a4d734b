"""estlab report: draws pages again from directories."""

import argparse
from collections.abc import Sequence
from pathlib import Path

from estlab.cli.parser import Parser
from estlab.errors import UserError, printable
from estlab.launch.launcher import OK


class ReportOptions(argparse.Namespace):
    """The options of the command line."""

    directories: list[Path]


def parser() -> Parser:
    """The command line of estlab report."""
    found = Parser(
        "report",
        "report DIR [DIR ...]",
        "Draws report.html in each directory of a run or a sweep, from the files there\n"
        "alone: one file with verdicts, tables, plots, configuration and provenance, to\n"
        "open in a browser or send to somebody. It needs no network. A run writes it at\n"
        "its end (unless report=false), and the same directory always gives the same\n"
        "page. The directory is shown as data: nothing in it is imported or run, and no\n"
        "link in it is followed.",
        "exit codes: 0 ok, 1 a page could not be written, 2 usage, 130 interrupted",
    )
    found.add_argument("directories", metavar="DIR", type=Path, nargs="*", help="directories of runs and sweeps")
    return found


def report(arguments: Sequence[str]) -> int:
    """Draw the requested pages and print where they are. Returns the exit code.

    Raises UserError before drawing any if a directory is not a run's or a sweep's.
    """
    options = parser().read(arguments, ReportOptions())
    if not options.directories:
        raise UserError("estlab report takes the directory of a run or a sweep, for example estlab report runs/latest")
    from estlab.report import page

    for directory in options.directories:
        page.is_sweep(directory)
    for directory in options.directories:
        print(printable(str(page.write(directory))))
    return OK


def folders(begun: str) -> list[str]:
    """The folders whose path begins like this, for the shell to complete."""
    above, slash, begins = begun.rpartition("/")
    try:
        found = sorted(path.name for path in Path(above + slash or ".").iterdir() if path.is_dir())
    except OSError:
        return []
    matching = [name for name in found if name.startswith(begins) and (begins or not name.startswith("."))]
    return [f"{above}{slash}{name}/" for name in matching]
